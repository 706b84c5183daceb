"""Reports of a comparison or a diagnosis: sentences, JSON, figures, one HTML page."""
