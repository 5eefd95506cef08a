"""The synthetic drive: a seeded world, its traffic, two renderers, and the nuScenes-format dataset of it."""
