"""What crosses the socket: the state that screens show and what they may ask."""
