"""What speaks against data or model: physical bounds, homogeneity, alignment, identifiability, residual."""
