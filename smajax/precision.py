"""Double precision: importing this switches it on for the whole process, and every part of smajax that computes imports it."""

import jax

jax.config.update("jax_enable_x64", True)
