"""CARRIES OUT the effects of the core, and turns what comes of them into its inputs."""
