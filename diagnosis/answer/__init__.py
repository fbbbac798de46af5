"""The answer: where the gap lies, which cause, how far it shrinks, what to do next."""
