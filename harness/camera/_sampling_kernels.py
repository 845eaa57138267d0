"""Compiled loops that sample images. Called through the modules beside this one, which prepare the arguments."""

from harness.compiled import kernel


@kernel
def bilinear(image, rows, columns, out):
    """Write bilinear samples of an image; beyond its border it is extended by its nearest pixels.

    rows, columns : `[n]`, whole numbers at the centres of pixels.
    """
    height, width = image.shape
    for i in range(rows.size):
        row, column = min(max(rows[i], 0.0), height - 1.0), min(max(columns[i], 0.0), width - 1.0)
        top, left = int(row), int(column)
        below, right = row - top, column - left
        bottom, east = min(top + 1, height - 1), min(left + 1, width - 1)
        above, beside = 1.0 - below, 1.0 - right
        value = (image[top, left] * above) * beside
        value += (image[top, east] * above) * right
        value += (image[bottom, left] * below) * beside
        value += (image[bottom, east] * below) * right
        out[i] = value
