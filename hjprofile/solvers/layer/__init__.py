"""A rolling layer of finite thickness (theory, §8)."""
