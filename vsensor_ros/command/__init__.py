"""One file a command, each thin."""
