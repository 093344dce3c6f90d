"""The panel of the report step."""
