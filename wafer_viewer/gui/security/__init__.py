"""Access to the page: guard of every request, server, self-test."""
