"""Several converted datasets of one fleet become one: inputs -> plan -> files and tables -> verification."""
