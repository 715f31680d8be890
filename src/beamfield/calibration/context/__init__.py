"""What localisation asks of a model: beams that count as much as they are worth, parameters learned in context."""
