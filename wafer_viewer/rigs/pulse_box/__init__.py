"""The pulse box: client and protocol."""
