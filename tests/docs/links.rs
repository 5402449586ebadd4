//! Links lead somewhere, pictures are small, the README is short.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::page::{self, Page};

const MOST_LINES_OF_README: usize = 200;
const MOST_OCTETS_OF_PICTURE: u64 = 200_000;

#[test]
fn the_readme_is_short() {
    let lines = crate::README.lines().count();
    assert!(lines <= MOST_LINES_OF_README, "README.md has {lines} lines");
}

/// Each page of `docs` can be reached from the README, too.
#[test]
fn every_link_leads_somewhere() {
    let pages = page::all();
    let mut faults = Vec::new();
    let mut from_readme = BTreeSet::new();
    for page in &pages {
        for (line, link) in page.links() {
            if ["http://", "https://", "mailto:"].iter().any(|scheme| link.starts_with(scheme)) {
                continue;
            }
            let (path, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if path.is_empty() { page.path.clone() } else { beside(page, path) };
            let of_target = pages.iter().find(|page| page.path == target);
            let has_anchor = |page: &Page| page.anchors().iter().any(|known| known == anchor);
            if !target.exists() || !anchor.is_empty() && !of_target.is_some_and(has_anchor) {
                faults.push(format!("{}:{line}: {link}", page.path.display()));
            }
            if page.path == Path::new("README.md") {
                from_readme.insert(target);
            }
        }
    }
    assert_eq!(faults, [""; 0]);
    let alone = pages.iter().map(|page| &page.path).filter(|path| path.starts_with("docs"));
    let alone: Vec<_> = alone.filter(|path| !from_readme.contains(*path)).collect();
    assert!(alone.is_empty(), "README.md has no link to {alone:?}");
}

/// All that are committed are shown, and all that are shown are there.
#[test]
fn pictures_are_small_and_shown() {
    let is_picture = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension == "png" || extension == "svg")
    };
    let pages = page::all();
    let shown = pages.iter().flat_map(|page| {
        page.links().into_iter().map(|(_, link)| beside(page, &link)).filter(is_picture)
    });
    let shown: BTreeSet<_> = shown.collect();
    let folders =
        ["docs/pictures", "benches/side_by_side"].map(|folder| fs::read_dir(folder).unwrap());
    let there = folders.into_iter().flatten().map(|entry| entry.unwrap().path());
    let there: BTreeSet<_> = there.filter(is_picture).collect();
    assert_eq!(shown, there);
    for picture in there {
        let octets = picture.metadata().unwrap().len();
        assert!(octets < MOST_OCTETS_OF_PICTURE, "{} has {octets} octets", picture.display());
    }
}

/// What a link of a page names, from the root of the repository.
fn beside(page: &Page, link: &str) -> PathBuf {
    let mut path = page.path.parent().unwrap().to_owned();
    for component in Path::new(link).components() {
        match component {
            Component::ParentDir => assert!(path.pop(), "{}: {link}", page.path.display()),
            Component::Normal(name) => path.push(name),
            _ => (),
        }
    }
    path
}
