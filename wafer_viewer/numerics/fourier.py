"""Lengths of Fourier transforms."""

from __future__ import annotations


def fast_length(n: int) -> int:
    """Return the smallest length of at least n for which a real Fourier transform is fast."""
    from scipy.fft import next_fast_len

    return next_fast_len(n, real=True) or n
