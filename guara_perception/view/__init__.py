"""What a person sees: pictures in one style, and a view in the browser."""
