"""Is anything outside the catalogue, and how far can the probabilities be believed?"""
