"""The experiments: short scripts a scientist can read and change."""
