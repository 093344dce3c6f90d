"""Controls, HTML, icons, style and the guard round callbacks."""
