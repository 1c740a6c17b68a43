"""The command line of `madrob`: what each command takes. Imports nothing that is slow."""
