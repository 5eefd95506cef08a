"""The nuScenes-format tables: read, index, subset, write; the rig of a dataset."""
