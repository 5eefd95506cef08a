"""unidrive: convert nuScenes-format datasets to one shared virtual camera rig."""

__version__ = "0.1.0"
