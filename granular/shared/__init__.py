"""What all three packages share: errors, the command lines' parser, pages, pictures, tables."""
