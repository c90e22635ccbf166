"""A rolling layer of finite thickness (§15)."""
