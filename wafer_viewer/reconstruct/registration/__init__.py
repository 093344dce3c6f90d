"""Registration of neighbouring fields in their overlap."""
