"""The conversion: plan -> units of work -> finalise."""
