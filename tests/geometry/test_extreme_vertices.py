"""Lists of vertices that may be extreme: whatever the direction, the extreme one is in the list of its cell."""

import numpy as np
import pytest

from safe_ompl.geometry.kernels import extreme_vertices
from safe_ompl.geometry.kernels.vertex_grids import cell_of


@pytest.mark.parametrize("grid", [1, 3, 8])
@pytest.mark.parametrize("number", [1, 5, 200])
def test_the_extreme_vertex_is_in_the_list_of_its_cell(rng, number, grid):
    vertices = rng.normal(size=(number, 3)) * [0.5, 0.1, 0.02] + [0.3, 0.0, -0.1]
    starts, found = extreme_vertices(vertices, grid)
    assert len(starts) == 6 * grid**2 + 1
    for direction in rng.normal(size=(2000, 3)):
        cell = cell_of(*direction, grid)
        listed = found[starts[cell] : starts[cell + 1]]
        assert (vertices[listed] @ direction).max() >= (vertices @ direction).max() - 1e-15


def test_directions_on_the_borders_of_cells():
    vertices = np.array(
        [[x, y, z] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) for z in (-1.0, 0.0, 1.0)]
    )
    starts, found = extreme_vertices(vertices, 4)
    for direction in np.array(np.meshgrid(*[np.linspace(-1, 1, 9)] * 3)).reshape(3, -1).T:
        cell = cell_of(*direction, 4)
        listed = found[starts[cell] : starts[cell + 1]]
        assert (vertices[listed] @ direction).max() == (vertices @ direction).max()


def test_what_is_inside_the_hull_is_not_listed(rng):
    corners = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    vertices = np.vstack([corners, rng.uniform(-0.5, 0.5, (100, 3))])
    starts, found = extreme_vertices(vertices, 4)
    assert found.max() < len(corners)
    assert len(found) < 3 * (len(starts) - 1)


def test_without_a_grid_there_is_one_cell():
    assert cell_of(0.1, -0.2, 0.3, 0) == 0
    assert cell_of(0.0, 0.0, 0.0, 4) == 0
