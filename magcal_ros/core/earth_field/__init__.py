"""The Earth's field at a place."""
