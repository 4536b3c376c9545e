"""From a record to equations that nobody wrote down before: sparse and symbolic regression."""
