"""How soon the viewer is there: from the start of the process to its address, and to the page it then serves.

    python tests/bench/bench_start.py [--quick]

The goal is an address within 3 s. --quick: two starts; otherwise six.
"""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request

GOAL_S = 3.0


def start_once() -> tuple[float, float]:
    """Seconds until the address is printed, and until the page has been fetched."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        command = [sys.executable, "-m", "wafer_viewer", "serve", "--port", "0", "--data", folder]
        viewer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = viewer.stdout.readline()
        address_s = time.perf_counter() - began
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        opener.open(re.search(r"http\S+", line).group(), timeout=30).read()
        page_s = time.perf_counter() - began
        viewer.send_signal(signal.SIGINT)
        viewer.communicate(timeout=60)
        return address_s, page_s


def main() -> None:
    parser = argparse.ArgumentParser(description="How soon the viewer is there.")
    parser.add_argument("--quick", action="store_true", help="two starts instead of six")
    for n in range(1, (2 if parser.parse_args().quick else 6) + 1):
        address_s, page_s = start_once()
        met = "met" if address_s <= GOAL_S else "MISSED"
        print(f"start {n}: address after {address_s:.2f} s (goal {GOAL_S:.0f} s {met}), page after {page_s:.2f} s")


if __name__ == "__main__":
    main()
