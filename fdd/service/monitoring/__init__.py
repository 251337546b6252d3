"""What watches: families of charts on filters, chillers, and the budget that they share."""
