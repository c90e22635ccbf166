"""Result folders, VTK files and pictures."""
