"""Design sweeps: many designs of one rig simulated at once, what they do, and the best of them refined by gradients."""
