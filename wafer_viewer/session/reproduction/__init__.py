"""The paper's jobs on the virtual rig, with its tables and figures."""
