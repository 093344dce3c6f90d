"""The dataset folder: frames, journal, record, lock, results."""
