"""How figures are graded and put into words."""
