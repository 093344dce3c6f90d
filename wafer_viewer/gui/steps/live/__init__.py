"""Live at the bench, a look of the step Plan: picture of the camera, drive, focus, light and places."""
