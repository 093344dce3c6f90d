"""Controls, HTML, icons, style and error handling of callbacks."""
