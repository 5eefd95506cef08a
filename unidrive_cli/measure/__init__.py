"""How good virtual pictures are: fidelity against the same drive rendered directly through the virtual rig."""
