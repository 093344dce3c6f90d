"""Dies, defects, their limits and the exchange of both."""
