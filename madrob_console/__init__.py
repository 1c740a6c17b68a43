"""The referee's console for the MADROB benchmark."""
