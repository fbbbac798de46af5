"""What a person is told: where the gap lies, which cause, how far it shrinks, what to do next."""
