"""The report's pictures, one module each; matplotlib is imported when one is drawn."""
