"""What a plan can tell, before it is measured.

Where things are
    worlds      robots drawn under a design, and the probabilities that the diagnosis would give them, all at once
    rates       how often each cause would be told right, and what it would be taken for
    foreseen    a case from a plan, and what each further experiment would bring
"""
