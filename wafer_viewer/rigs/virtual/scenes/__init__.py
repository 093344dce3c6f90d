"""The samples that may lie under the virtual microscope: one module each, all pure functions of stage micrometres."""
