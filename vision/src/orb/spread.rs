//! Choosing corners so that they cover the image.

use super::fast::Corner;

/// At most `quota` of `corners`.
pub(super) fn spread(corners: &[Corner], _width: u32, _height: u32, quota: usize) -> Vec<Corner> {
    let mut kept = corners.to_vec();
    kept.sort_by_key(|c| (std::cmp::Reverse(c.score), c.y, c.x));
    kept.truncate(quota);
    kept
}
