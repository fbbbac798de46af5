"""Campaigns: runs of protocols in a designed order, planned as a whole, done one after another, and resumed as a whole."""
