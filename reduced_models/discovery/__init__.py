"""Discovery of equations of motion from records: sparse and symbolic regression."""
