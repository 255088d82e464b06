"""How the network that refines silhouettes was trained: simulated people before photographs."""
