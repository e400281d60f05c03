"""The smoother: a calibration from a whole drive (doc/smoother.md, "Long drives")."""
