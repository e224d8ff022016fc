"""Finite-element model of the cross-section of a flexural actuator: linear triangles along the edges of the wires, sparse LU of SciPy.

It shares nothing with smajax, neither equations nor grid: Delaunay triangles through rings of points around and within each wire and through
points on the layers' interfaces, lumped capacities, Crank-Nicolson after two half steps of Euler's rule.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay

TAPE, SILICONE, WIRE = (
    (2430.0, 1000.0, 2.2),
    (1070.0, 1050.0, 0.2),
    (6450.0, 837.4, 18.0),
)  # density, heat capacity, conductivity


@dataclass
class Section:
    """Lengths in m; the wires lie evenly over the width, or ``pitch`` apart in its middle."""

    diameter: float = 300e-6
    count: int = 2
    width: float = 22e-3
    tape: float = 0.5e-3
    silicone: float = 0.6e-3
    offset: float = 0.0
    pitch: float | None = None
    convection: float = 10.0
    ambient: float = 20.0
    wire_start: float = 80.0
    elastomer_start: float = 50.0
    materials: tuple = (TAPE, SILICONE, WIRE)

    def wires(self) -> np.ndarray:
        """Centres of the wires on half the section, from its plane of symmetry."""
        places = (np.arange(self.count) - (self.count - 1) / 2) * (self.pitch or self.width / self.count)
        return places[places > -1e-12]


def _points(section: Section, rings: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes, and the rows of those at the centres of the wires."""
    half, height, radius = section.width / 2, 2 * section.tape + section.silicone, section.diameter / 2
    level = height / 2 + section.offset
    step, places = radius / rings, section.wires()
    neighbour = 0.5 * np.min(np.diff(places)) if len(places) > 1 else half
    room = min(section.silicone / 2 - abs(section.offset), neighbour, half - places[-1])
    radii = list(step * np.arange(rings + 1))
    while radii[-1] * (1 + 1.1 / rings) + 0.6 * step < room and len(radii) < 3 * rings:
        radii.append(radii[-1] * (1 + 1 / rings))
    reach = radii[-1] + 0.6 * step
    # Columns with the spacing of the rings near the wires, then a larger one.
    columns = [0.0]
    while columns[-1] < half:
        away = max(np.min(np.abs(places - columns[-1])) - 1.2 * reach, 0.0)
        columns.append(columns[-1] + min(1.5 * step + 0.15 * away, 0.2e-3))
    x = np.array(columns) * half / columns[-1]
    fine = max(6, int(section.silicone / (1.5 * step)))
    lower = np.linspace(0, section.tape, fine + 1)
    z = np.concatenate([lower, section.tape + np.linspace(0, section.silicone, fine + 1)[1:], height - lower[::-1][1:]])
    grid = np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = np.column_stack([places, np.full(len(places), level)])
    apart = np.min(np.linalg.norm(grid[:, None] - centres[None], axis=2), axis=1)
    nodes = [grid[apart > reach]]
    count = 4 * int(np.ceil(1.5 * rings))
    for place, _ in centres:
        turned = []
        for k, r in enumerate(radii[1:], 1):
            angles = (
                np.pi
                * 2
                * (np.arange(min(6 * k, count) if k < rings else count))
                / (min(6 * k, count) if k < rings else count)
            )
            turned.append(np.column_stack([place + r * np.cos(angles), level + r * np.sin(angles)]))
        ring = np.concatenate(turned)
        on_axis = np.abs(place) < 1e-12
        # Half of a wire on the plane of symmetry is modelled.
        ring = (
            np.concatenate([ring[ring[:, 0] > 1e-9], [[0.0, level + s * r] for r in radii[1:] for s in (-1, 1)]])
            if on_axis
            else ring
        )
        nodes.append(ring)
    return np.concatenate([centres, *nodes]), np.arange(len(centres))


def cool(section: Section, duration: float, rings: int = 12, step: float = 2.5e-3) -> tuple[np.ndarray, np.ndarray]:
    """Times and the temperature at the centre of the hottest wire; ``rings`` rings of nodes lie within a wire."""
    height, radius = 2 * section.tape + section.silicone, section.diameter / 2
    nodes, centre_nodes = _points(section, rings)
    corners = Delaunay(nodes).simplices
    p = nodes[corners]
    edges = p[:, [2, 0, 1]] - p[:, [1, 2, 0]]
    area = 0.5 * np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    corners, p, edges, area = (a[area > 1e-6 * area.max() * 1e-3] for a in (corners, p, edges, area))
    middle = p.mean(axis=1)
    centres = nodes[centre_nodes]
    in_wire = np.min(np.linalg.norm(middle[:, None] - centres[None], axis=2), axis=1) < radius
    in_tape = (middle[:, 1] < section.tape) | (middle[:, 1] > height - section.tape)
    kind = np.where(in_wire, 2, np.where(in_tape, 0, 1))
    density, heat, conductivity = np.array(section.materials)[kind].T
    # The chords reduce the area of the circle; the heat capacity of the wire is corrected.
    whole = sum(np.pi * radius**2 * (0.5 if abs(c) < 1e-12 else 1.0) for c in section.wires())
    third = area * density * heat / 3 * np.where(in_wire, whole / area[in_wire].sum(), 1.0)
    n = len(nodes)
    capacity = np.bincount(corners.ravel(), np.repeat(third, 3), n)
    warm = np.bincount(corners.ravel(), np.repeat(third * in_wire, 3), n)
    rigidity = conductivity[:, None, None] * np.einsum("eid,ejd->eij", edges, edges) / (4 * area)[:, None, None]
    network = sp.coo_matrix(
        (rigidity.ravel(), (np.repeat(corners, 3, axis=1).ravel(), np.tile(corners, (1, 3)).ravel())), (n, n)
    ).tocsc()
    air = np.zeros(n)
    for axis, at, other in ((1, 0.0, 0), (1, height, 0), (0, section.width / 2, 1)):
        rim = np.flatnonzero(np.abs(nodes[:, axis] - at) < 1e-10)
        rim = rim[np.argsort(nodes[rim, other])]
        length = np.diff(nodes[rim, other])
        air[rim[:-1]] += 0.5 * section.convection * length
        air[rim[1:]] += 0.5 * section.convection * length
    network = network + sp.diags(air)
    excess = (
        section.elastomer_start - section.ambient + (section.wire_start - section.elastomer_start) * warm / capacity
    )
    lu = splu((sp.diags(capacity) + 0.5 * step * network).tocsc())
    temperatures = [excess[centre_nodes].max()]
    for i in range(round(duration / step)):
        if i == 0:
            for _ in range(2):
                excess = lu.solve(capacity * excess)
        else:
            excess = lu.solve(capacity * excess - 0.5 * step * (network @ excess))
        temperatures.append(excess[centre_nodes].max())
    return step * np.arange(len(temperatures)), np.array(temperatures) + section.ambient


def cooled(time: np.ndarray, temperature: np.ndarray, target: float = 55.0) -> float:
    """Return the time at which the temperature passes the target."""
    k = int(np.argmax(temperature <= target))
    share = (temperature[k - 1] - target) / (temperature[k - 1] - temperature[k])
    return float(time[k - 1] + share * (time[k] - time[k - 1]))
