# Copyright 2026 The obb_collision developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Validation of arguments at the public edge. Errors name the argument and the row."""

from __future__ import annotations

import math
import re
import sys
import threading
import warnings
from collections.abc import Iterator, Sized
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision._threads import run
from obb_collision.numerics.constants import MAX_MAGNITUDE, ORTHONORMAL_ROUNDING
from obb_collision.numerics.vec3 import components, dot, plus, rows_at
from obb_collision.typing import Axes, Floats, Vector
from obb_collision.words import shown


def check_kind(value: Any, kind: Any, name: str, *others: type) -> None:
    """Raise TypeError naming the argument unless a value is an instance of one of the types."""
    if not isinstance(value, (kind, *others)):
        kinds = " or ".join(accepted.__name__ for accepted in (kind, *others))
        raise TypeError(f"{name} must be {kinds}, got {shown(value)}")


#: No two parts of it take the same digits, so a text that is no number is found in one pass.
NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?", re.ASCII)


def number_of(text: str) -> float | None:
    """Return a decimal text as a number; None for other texts and beyond MAX_MAGNITUDE."""
    number = math.nan if NUMBER.fullmatch(text) is None else float(text)
    return number if abs(number) <= MAX_MAGNITUDE else None


def as_flag(value: object, name: str) -> bool:
    """Return True or False; TypeError naming the argument for anything else."""
    if value is True or value is False:
        return value
    check_kind(value, bool, name, np.bool_)
    return bool(value)


def select_rows(array: NDArray[Any], rows: Any, name: str, dimensions: int) -> NDArray[Any]:
    """Return the rows that an index array, a mask or a single index selects.

    dimensions: number of dimensions of the result. Raises ValueError naming the argument otherwise.
    """
    try:
        selected: NDArray[Any] = array[rows]
    except (IndexError, TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{name} must be rows of {len(array)}: {error}") from None
    if not isinstance(selected, np.ndarray) or selected.ndim != dimensions:
        raise ValueError(f"{name} must be rows of {len(array)}, got {shown(rows)}")
    return selected


#: Largest whole number accepted where there is no other limit: the largest index.
MAX_WHOLE = 2**63 - 1

#: Largest entry of R^T R - I of a matrix that is accepted as a rotation.
ORTHONORMAL_TOLERANCE = 1e-6

#: How far from 1 the length of a quaternion may be without a warning: 0.7, 0.7 for a quarter turn
#: is 1 % off. Farther off, the numbers may be angles, for example.
UNIT_TOLERANCE = 0.1


#: Added to numbers, it makes 0.0 of -0.0.
POSITIVE: Vector = (0.0, 0.0, 0.0)

#: Kinds of numpy's numeric types; objects (O) are converted one by one.
NUMBERS = "buifO"
#: Maximum length of numpy's error message that is repeated.
MAX_REASON = 200
#: Half extents, three per box, below which a second thread does not pay: 40 us.
FEWEST_SIZES = 65536


def _shape_text(shape: tuple[int | None, ...]) -> str:
    sizes = ["n" if size is None else str(size) for size in shape]
    return f"({sizes[0]},)" if len(sizes) == 1 else f"({', '.join(sizes)})"


def first_bad_row(bad: NDArray[np.bool_], numbers: NDArray[np.int64] | None = None) -> str:
    """Return ' in row K' for the first row of ``bad`` with a True, '' for a single value.

    numbers (n,): row numbers in the caller's array, if these are only some of its rows.
    """
    if bad.ndim == 0:
        return ""
    row = int(np.argmax(bad.reshape(bad.shape[0], -1).any(axis=1)))
    return f" in row {row if numbers is None else int(numbers[row])}"


def refuse_where(
    bad: NDArray[np.bool_], why: str, by_row: bool = True, numbers: NDArray[np.int64] | None = None
) -> None:
    """Raise ValueError if anything is bad; by_row: with the number of the first bad row."""
    if bad.any():
        raise ValueError(why + (first_bad_row(bad, numbers) if by_row else ""))


def check_lengths(**sides: Sized) -> None:
    """Raise ValueError naming all arguments unless they have the same length."""
    lengths = [str(len(side)) for side in sides.values()]
    if len(set(lengths)) > 1:
        names, numbers = (f"{', '.join(x[:-1])} and {x[-1]}" for x in ([*sides], lengths))
        raise ValueError(f"{names} must have the same length, got {numbers}")


_this_thread = threading.local()


@contextmanager
def without_warnings() -> Iterator[None]:
    """Let this thread warn of nothing: the caller reports doubts in another way."""
    _this_thread.is_quiet = True
    try:
        yield
    finally:
        _this_thread.is_quiet = False


def warn_caller(message: str) -> None:
    """Warn at the line that called this package."""
    if getattr(_this_thread, "is_quiet", False):
        return
    package = __name__.partition(".")[0]
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == package:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, UserWarning, stacklevel=level)


def as_array(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Floats:
    """Return ``value`` as a finite, contiguous float64 array of the shape (None: any length).

    Not copied if it already is one that may be written to. Raises ValueError naming the argument
    and, for arrays with a free first length, the row.
    """
    array = as_shaped(value, name, shape)
    check_magnitude(array, name, by_row=bool(shape) and shape[0] is None)
    return array


def as_shaped(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Floats:
    """Return ``value`` as ``as_array`` does, but accept infinite numbers and NaN.

    Read-only arrays are copied: kernels are compiled for writable ones.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.flags.carray:
        array = value
    else:
        wanted = f"numbers of shape {_shape_text(shape)}"
        numbers = as_any_array(value, name, wanted)
        try:
            array = np.array(numbers, np.float64, order="C")
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{name} must be {wanted}: {str(error)[:MAX_REASON]}") from None
    sizes = array.shape[:1] + shape[1:] if shape and shape[0] is None else shape
    if array.shape != sizes or array.ndim != len(shape):
        raise ValueError(f"{name} must have shape {_shape_text(shape)}, got {array.shape}")
    return array


def as_any_array(value: ArrayLike, name: str, what: str) -> NDArray[Any]:
    """Return an array of real numbers of any type; ValueError naming the argument otherwise.

    what: description of the expected value for the error. Strings and complex numbers are refused.
    """
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError) as error:  # ragged
        raise ValueError(f"{name} must be {what}: {str(error)[:MAX_REASON]}") from None
    if array.dtype.kind not in NUMBERS:
        raise ValueError(f"{name} must be {what}, got {array.dtype}")
    return array


def is_single(points: ArrayLike) -> bool:
    """Return whether an argument is a single point (3,) and not an array (n, 3)."""
    try:
        return np.ndim(points) == 1
    except ValueError:  # ragged: refused by the conversion that follows
        return False


def as_points(value: ArrayLike, name: str) -> NDArray[np.floating]:
    """Return points (n, 3), uncopied if native, aligned float32 or float64, else as float64.

    They need not be finite. Raises ValueError naming the argument for another shape or kind.
    """
    array = as_any_array(value, name, "numbers of shape (n, 3)")
    usable = array.dtype in (np.float32, np.float64) and array.flags.aligned
    try:
        if not (usable and array.dtype.isnative):
            array = array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        why = str(error)[:MAX_REASON]
        raise ValueError(f"{name} must be numbers of shape (n, 3): {why}") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (n, 3), got {array.shape}")
    return array


def as_whole(value: object, name: str, minimum: int = 0, maximum: int = MAX_WHOLE) -> int:
    """Return a whole number from ``minimum`` to ``maximum``; ValueError naming it otherwise.

    For sizes, indices and depths: neither True nor 1.0 is accepted.
    """
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not minimum <= int(value) <= maximum:  # type: ignore[call-overload]
        bounds = f"from {minimum} to {maximum}" if maximum < MAX_WHOLE else f"at least {minimum}"
        raise ValueError(f"{name} must be a whole number, {bounds}, got {shown(value)}")
    return int(value)  # type: ignore[call-overload]


def as_indices(value: ArrayLike, name: str, what: str) -> NDArray[Any]:
    """Return a copy of real numbers of any type; ValueError as ``as_any_array``.

    A copy, as kernels release the interpreter's lock and use indices unchecked: no other thread may
    write to them once they are checked.
    """
    return np.array(as_any_array(value, name, what), order="C")


def as_rows(value: ArrayLike, name: str, count: int) -> NDArray[np.int64]:
    """Return whole numbers (m,) from 0 to ``count`` - 1 as contiguous int64, always a copy.

    Raises ValueError naming the argument and the row for anything else.
    """
    array = as_indices(value, name, "whole numbers of shape (m,)")
    if array.shape == (0,):
        return np.empty(0, np.int64)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(
            f"{name} must be whole numbers of shape (m,), got {array.dtype} of shape {array.shape}"
        )
    refuse_where((array < 0) | (array >= count), f"{name} must be from 0 to {count - 1}")
    return array.astype(np.int64, copy=False)


def check_magnitude(array: Floats, name: str, by_row: bool) -> None:
    """Raise ValueError unless all of ``array`` is finite and at most MAX_MAGNITUDE."""
    if _are_within(array.reshape(-1)):
        return
    with np.errstate(invalid="ignore"):
        good = np.abs(array) <= MAX_MAGNITUDE  # False for NaN too
    if good.all():
        return
    where = first_bad_row(~good) if by_row else ""
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite{where}")
    raise ValueError(f"{name} must not exceed {MAX_MAGNITUDE:g} in magnitude{where}")


@njit
def _are_within(numbers: Floats) -> bool:
    good = True
    for number in numbers:
        good &= abs(number) <= MAX_MAGNITUDE  # False for NaN, too
    return good


def as_half_extents(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Floats:
    """Return non-negative half extents of the shape (zero is legal: flat boxes)."""
    array = as_shaped(value, name, shape)
    sizes = np.empty_like(array)
    if all(run(_take_sizes, array.size, FEWEST_SIZES, array.reshape(-1), sizes.reshape(-1))):
        return sizes
    check_magnitude(array, name, by_row=shape[0] is None)
    refuse_where(array < 0.0, f"{name} must not be negative", shape[0] is None)
    return array + 0.0


@njit
def _take_sizes(numbers: Floats, out: Floats, start: int, stop: int) -> bool:
    """Write numbers from ``start`` to ``stop``; return whether all are valid half extents."""
    sizes, places = numbers[start:stop], out[start:stop]
    good = True
    for n in range(len(sizes)):  # vectorised: without a branch, and no index is negative
        good &= (sizes[n] >= 0.0) & (sizes[n] <= MAX_MAGNITUDE)  # False for NaN
        places[n] = sizes[n] + 0.0  # -0.0 becomes 0.0, so that equal boxes are equal bit for bit
    return good


def as_quaternions(
    value: ArrayLike,
    name: str,
    shape: tuple[int | None, ...],
    numbers: NDArray[np.int64] | None = None,
    warn: bool = True,
) -> Floats:
    """Return unit quaternions x y z w, shape (4,) or (n, 4).

    Raises ValueError for a quaternion of length zero. warn: whether to warn of one whose length is
    farther than UNIT_TOLERANCE from 1. Scaled by the largest component first, so that nothing
    under- or overflows. numbers: as for ``first_bad_row``.
    """
    array = as_array(value, name, shape)
    largest = np.abs(array).max(axis=-1, keepdims=True, initial=0.0)
    by_row = shape[0] is None
    refuse_where(largest[..., 0] == 0.0, f"{name} must not be a zero quaternion", by_row, numbers)
    scaled = array / largest
    norm: Floats = np.sqrt((scaled * scaled).sum(axis=-1, keepdims=True))
    far = np.abs((largest * norm)[..., 0] - 1.0) > UNIT_TOLERANCE
    if warn and far.any():
        where = first_bad_row(far, numbers) if by_row else ""
        length = float((largest * norm)[..., 0].flat[int(np.argmax(far))])
        warn_caller(f"{name} far from unit length{where}: {length:.3g}; taken as normalised")
    return scaled / norm


def as_rotations(value: ArrayLike, name: str, shape: tuple[int | None, ...]) -> Floats:
    """Return rotation matrices, (3, 3) or (n, 3, 3), whose columns are the box axes.

    Orthonormal to rounding: kept bit for bit. Orthonormal to 1e-6: made orthonormal by the
    nearest rotation (polar decomposition). A left-handed frame gets its third axis reversed: the
    same box, with determinant +1. Otherwise ValueError.
    """
    array = as_array(value, name, shape)
    stack = array.reshape(-1, 3, 3)
    defect = orthonormal_defect(stack)
    wrong = ~(np.abs(defect) <= ORTHONORMAL_TOLERANCE)
    if wrong.any():
        row = int(np.argmax(wrong))
        where = f" in row {row}" if shape[0] is None else ""
        raise ValueError(
            f"{name} must be orthonormal to {ORTHONORMAL_TOLERANCE:g}{where}: "
            f"R^T R differs from the identity by {abs(defect[row]):.3g}"
        )
    left_handed = np.signbit(defect)
    loose = np.abs(defect) > ORTHONORMAL_ROUNDING
    if left_handed.any() or loose.any():
        stack = stack.copy()
        stack[left_handed, :, 2] *= -1.0
        stack[loose] = orthonormalize(stack[loose])
    return stack.reshape(array.shape)


def check_last_rows(matrices: Floats, name: str) -> None:
    """Raise ValueError for matrices (n, 4, 4) whose last row is not 0 0 0 1, with the first one."""
    last = np.array([0.0, 0.0, 0.0, 1.0])
    for matrix in matrices[(matrices[:, 3] != last).any(axis=1)][:1]:
        hint = "; transpose it: its last column is" if (matrix[:, 3] == last).all() else ""
        raise ValueError(f"{name} must have the last row 0 0 0 1, got {matrix[3].tolist()}{hint}")


@njit
def orthonormal_defect(stack: Floats) -> Floats:
    """Return (n,) the largest entry of abs(R^T R - I) of each matrix of (n, 3, 3).

    It has the sign of the determinant: negative, or -0.0, for left-handed frames.
    """
    defect = np.empty(len(stack))
    for n in range(len(stack)):
        defect[n] = defect_of(rows_at(stack, n))
    return defect


@njit
def defect_of(matrix: Axes) -> float:
    """Return the ``orthonormal_defect`` of one matrix, as rows."""
    a, b, c = matrix
    x, y, z = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
    largest = _worse(abs(dot(x, y)), abs(dot(x, x) - 1.0))
    largest = _worse(abs(dot(y, y) - 1.0), _worse(abs(dot(x, z)), largest))
    largest = _worse(abs(dot(z, z) - 1.0), _worse(abs(dot(y, z)), largest))
    determinant = (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )
    return -largest if determinant < 0.0 else largest


@njit
def _worse(error: float, largest: float) -> float:
    return error if not error <= largest else largest  # NaN stays


def orthonormalize(stack: Floats) -> Floats:
    """Return the orthonormal matrices nearest to (n, 3, 3), which must nearly be so."""
    result = np.empty_like(stack)
    _orthonormalize_kernel(np.ascontiguousarray(stack), result)
    return result


@njit
def _orthonormalize_kernel(stack: Floats, out: Floats) -> None:
    for n in range(len(stack)):
        rows = orthonormal_of(rows_at(stack, n))
        for i in range(3):
            for j in range(3):
                out[n, i, j] = rows[i][j]


@njit
def orthonormal_of(matrix: Axes) -> Axes:
    """Return the rows of one matrix, made orthonormal as by ``orthonormalize``.

    Newton's iteration for the polar factor, R <- R (3 I - R^T R) / 2 (Higham, Functions of
    Matrices, 8.3): quadratic, so two steps from a defect below 1e-6 reach rounding; a third
    one is a reserve.
    """
    for _ in range(3):
        a, b, c = matrix
        x, y, z = (a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2])
        xy, xz, yz = -0.5 * dot(x, y), -0.5 * dot(x, z), -0.5 * dot(y, z)
        factor = (
            (1.5 - 0.5 * dot(x, x), xy, xz),
            (xy, 1.5 - 0.5 * dot(y, y), yz),
            (xz, yz, 1.5 - 0.5 * dot(z, z)),
        )
        matrix = components(factor, a), components(factor, b), components(factor, c)
    a, b, c = matrix
    return plus(a, POSITIVE), plus(b, POSITIVE), plus(c, POSITIVE)
