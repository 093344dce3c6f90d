"""The frozen state that the page reads."""
