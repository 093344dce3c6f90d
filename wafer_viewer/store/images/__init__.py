"""Images taken elsewhere: what their files say of themselves, their order in z, and their fields."""
