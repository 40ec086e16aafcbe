"""Results as documents and plots."""
