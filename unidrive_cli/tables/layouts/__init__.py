"""How the families of nuScenes-format datasets lay out their folders and tables: one file each."""
