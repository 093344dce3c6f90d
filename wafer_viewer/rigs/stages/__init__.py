"""Motion controllers on serial ports, and the stage that is composed of their axes."""
