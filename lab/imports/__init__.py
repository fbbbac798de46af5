"""Turn measurements of other laboratories and programs into a case, with a map that states what each column is."""
