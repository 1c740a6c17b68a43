"""The subcommands of `madrob`, one a module; each is imported only when it is used."""
