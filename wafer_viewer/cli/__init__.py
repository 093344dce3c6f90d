"""Command line: one module per subject, parser, arguments and output."""
