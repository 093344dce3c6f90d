"""``python -m wafer_viewer``: the command line."""

import sys

from wafer_viewer.cli.app import main

if __name__ == "__main__":
    sys.exit(main())
