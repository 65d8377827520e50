"""Independent cars, concealed cases, campaigns and benchmarks: what tests the product and is no part of it."""
