"""The step Review: search, list, map and gallery of defects, and their judgement with that of results."""
