"""Plans, jobs, releases and the guided tour."""
