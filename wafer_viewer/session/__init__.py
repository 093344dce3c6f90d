"""The operator's session: state, verbs, background work."""
