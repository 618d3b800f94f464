//! As much of Markdown as links and headings need.

use std::collections::BTreeMap;

/// The lines outside of fenced blocks.
fn prose(text: &str) -> Vec<&str> {
    let mut is_fenced = false;
    let outside = |line: &&str| {
        let is_fence = line.trim_start().starts_with("```");
        is_fenced ^= is_fence;
        !is_fenced && !is_fence
    };
    text.lines().filter(outside).collect()
}

/// The headings, without markup.
pub fn headings(text: &str) -> Vec<String> {
    let heading = |line: &&str| {
        let title = line.trim_start_matches('#');
        let level = line.len() - title.len();
        ((1..=6).contains(&level) && title.starts_with(' ')).then(|| title.trim().replace(['`', '*'], ""))
    };
    prose(text).iter().filter_map(heading).collect()
}

/// The anchors of the headings, as forges make them: lower case, hyphens for spaces, other punctuation
/// dropped, and numbered where a heading is repeated.
pub fn anchors(text: &str) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut anchor = |heading: String| {
        let kept = heading.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        let slug: String =
            kept.flat_map(char::to_lowercase).map(|c| if c == ' ' { '-' } else { c }).collect();
        let n_before = seen.entry(slug.clone()).or_default();
        *n_before += 1;
        if *n_before == 1 { slug } else { format!("{slug}-{}", *n_before - 1) }
    };
    headings(text).into_iter().map(&mut anchor).collect()
}

/// The targets of `[text](target)`, code left out.
pub fn link_targets(text: &str) -> Vec<String> {
    let text = prose(text).join("\n");
    // What stands at odd places between backticks is code.
    let without_code: String = text.split('`').step_by(2).collect();
    let ends = without_code.split("](").skip(1);
    ends.filter_map(|rest| rest.split_once(')')).map(|(target, _)| target.to_owned()).collect()
}

#[test]
fn anchors_are_those_of_forges() {
    let text = "# Where, and why?\n```\n# no heading\n```\n## `track` it\n## Again\n## Again\n#nothing";
    assert_eq!(headings(text), ["Where, and why?", "track it", "Again", "Again"]);
    assert_eq!(anchors(text), ["where-and-why", "track-it", "again", "again-1"]);
}

#[test]
fn links_in_code_are_none() {
    let text = "[a](b.md#c) `[d](e)` [`f`](g)\n```\n[h](i)\n```\n[j\nk](l)";
    assert_eq!(link_targets(text), ["b.md#c", "g", "l"]);
}
