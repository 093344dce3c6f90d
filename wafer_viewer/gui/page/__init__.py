"""Header, status bar, dialogs and other parts common to all steps."""
