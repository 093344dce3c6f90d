"""The command line: one file per subject, its parser, its arguments and its output."""
