"""The shapes that bodies are made of, each a plugin. How they move is in `motions`, what they do to cloth in
`penalty` and `sliding`.
"""
