"""Virtual and real camera rigs: the model, the YAML format, the gallery."""
