"""Input-output models: black boxes that map an electrical input to a measured output, without a model of the wire.

Models of hysteresis are ``bouc_wen`` and ``prandtl_ishlinskii`` with its inverse, ``prandtl_ishlinskii_inverse``.
Dynamic models are ``transfer_function``, ``hammerstein_wiener``, ``narx`` (a network), and ``switched`` (a network
during heating, a recovery curve during cooling). ``base`` holds their common interface;
``response.compute_response`` evaluates any of them on a recording. ``smajax.fitting.io_models`` fits them.
"""

from smajax.laws.base import AbstractInputOutputModel as AbstractInputOutputModel
from smajax.laws.bouc_wen import BoucWen as BoucWen
from smajax.laws.hammerstein_wiener import HammersteinWiener as HammersteinWiener
from smajax.laws.narx import Narx as Narx
from smajax.laws.prandtl_ishlinskii import PrandtlIshlinskii as PrandtlIshlinskii
from smajax.laws.prandtl_ishlinskii_inverse import InversePrandtlIshlinskii as InversePrandtlIshlinskii
from smajax.laws.switched import Switched as Switched
from smajax.laws.transfer_function import TransferFunction as TransferFunction
