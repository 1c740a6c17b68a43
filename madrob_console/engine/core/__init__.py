"""DECIDES: `step(input, now)` returns effects. No file, clock, thread, callback or socket."""
