"""What a team takes home: its runs in one zip, with what opens them."""
