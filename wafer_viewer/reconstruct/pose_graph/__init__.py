"""The poses of all fields, solved from their overlaps."""
