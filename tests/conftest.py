"""What all tests share."""

from __future__ import annotations

import signal

# Started in the background a shell lets its children ignore ctrl-C, and theirs inherit that: the programs under test
# are to hear it however the tests were started.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
