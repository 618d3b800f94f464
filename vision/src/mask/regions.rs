//! Connected parts of a small image.

/// Numbers the connected parts of the pixels for which `belongs`, neighbors being those at the four sides,
/// from 1; 0 is what does not belong. Returns the numbers and how many there are.
pub(super) fn label(width: usize, height: usize, belongs: impl Fn(usize) -> bool) -> (Vec<u32>, u32) {
    let mut labels = vec![0u32; width * height];
    let (mut n_parts, mut stack) = (0, Vec::new());
    for seed in 0..width * height {
        if labels[seed] != 0 || !belongs(seed) {
            continue;
        }
        n_parts += 1;
        labels[seed] = n_parts;
        stack.push(seed);
        while let Some(at) = stack.pop() {
            for next in sides(at, width, height) {
                if labels[next] == 0 && belongs(next) {
                    labels[next] = n_parts;
                    stack.push(next);
                }
            }
        }
    }
    (labels, n_parts)
}

/// The neighbors at the four sides.
pub(super) fn sides(at: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (at % width, at / width);
    let of = |exists: bool, neighbor: usize| exists.then_some(neighbor);
    [
        of(x > 0, at.wrapping_sub(1)),
        of(x + 1 < width, at + 1),
        of(y > 0, at.wrapping_sub(width)),
        of(y + 1 < height, at + width),
    ]
    .into_iter()
    .flatten()
}

/// Grows what is set by so many pixels, within the image.
pub(super) fn grow(set: &mut [bool], width: usize, by: usize) {
    if width == 0 {
        return;
    }
    for _ in 0..by {
        let before = set.to_vec();
        let rows: Vec<&[bool]> = before.chunks_exact(width).collect();
        for (y, row) in set.chunks_exact_mut(width).enumerate() {
            for other in [y.checked_sub(1), Some(y + 1)].into_iter().flatten().filter_map(|y| rows.get(y)) {
                row.iter_mut().zip(*other).for_each(|(set, other)| *set |= *other);
            }
            row[1..].iter_mut().zip(rows[y]).for_each(|(set, left)| *set |= *left);
            row.iter_mut().zip(&rows[y][1..]).for_each(|(set, right)| *set |= *right);
        }
    }
}
