"""A GigE Vision camera on the loopback interface: its argument is the fraction of lost packets."""

from __future__ import annotations

import sys

from wafer_viewer.rigs.cameras.aravis import import_aravis

if __name__ == "__main__":
    camera = import_aravis().GvFakeCamera.new("127.0.0.1", "GV01")
    camera.set_property("gvsp-lost-ratio", float(sys.argv[1]))
    print("ready" if camera.is_running() else "refused", flush=True)
    sys.stdin.read()  # ends with the program that started this one
