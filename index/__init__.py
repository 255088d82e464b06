"""The silhouette-skeleton database: poses, cameras, search and matching; no HTTP."""
