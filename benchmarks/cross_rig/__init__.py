"""Train on one car, deploy on another: small detectors across the paper's rigs, raw and converted."""
