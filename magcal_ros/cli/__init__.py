"""The magcal command and its subcommands."""
