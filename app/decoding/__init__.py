"""Pictures of expensive formats, decoded in processes of their own. Imports video and below."""
