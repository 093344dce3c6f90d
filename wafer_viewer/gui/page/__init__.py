"""Header, status bar, dialogs and what else belongs to the whole page."""
