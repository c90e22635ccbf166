"""What people keep: result folders, VTK files, pictures."""
