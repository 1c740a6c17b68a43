"""TALKS: the engine's socket, its client, and what finds and names engines."""
