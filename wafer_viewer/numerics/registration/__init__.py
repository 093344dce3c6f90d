"""Subpixel registration of images."""
