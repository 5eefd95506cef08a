"""The search for a virtual rig: search space, objective, CMA-ES."""
