//! A page in Markdown, as far as the tests have to understand it: fenced blocks, links, headings.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A block between fences, without the indentation of the list that it stands in.
#[derive(Debug, Default)]
pub(crate) struct Block {
    /// What stands behind the opening fence: `sh`, `toml`.
    pub(crate) language: String,
    pub(crate) text: String,
    /// The last line with text above the block.
    pub(crate) above: String,
    /// The line of the opening fence, from 1.
    pub(crate) line: usize,
}

impl Block {
    /// Why no test can run it, when the line above says so.
    pub(crate) fn not_run(&self) -> Option<&str> {
        self.above.strip_prefix("<!-- not run: ")?.strip_suffix(" -->")
    }
}

/// One page.
#[derive(Debug)]
pub(crate) struct Page {
    /// From the root of the repository.
    pub(crate) path: PathBuf,
    pub(crate) blocks: Vec<Block>,
    /// Lines outside of blocks, with their numbers.
    lines: Vec<(usize, String)>,
}

impl Page {
    pub(crate) fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap();
        let (mut blocks, mut lines) = (Vec::new(), Vec::new());
        let mut open: Option<(usize, Block)> = None;
        let mut above = "";
        for (number, line) in (1..).zip(text.lines()) {
            let (trimmed, indentation) = (line.trim_start(), line.len() - line.trim_start().len());
            match &mut open {
                None => {
                    if let Some(language) = trimmed.strip_prefix("```") {
                        let (language, above) = (language.to_owned(), above.to_owned());
                        let block = Block { language, above, line: number, ..Block::default() };
                        open = Some((indentation, block));
                    } else {
                        lines.push((number, line.to_owned()));
                        above = if trimmed.is_empty() { above } else { trimmed };
                    }
                }
                Some(_) if trimmed == "```" => {
                    blocks.extend(open.take().map(|(_, block)| block));
                    above = "";
                }
                Some((outer, block)) => {
                    block.text += line.get((*outer).min(indentation)..).unwrap();
                    block.text.push('\n');
                }
            }
        }
        assert!(open.is_none(), "{}: a block is not closed", path.display());
        Self { path: path.to_owned(), blocks, lines }
    }

    /// Targets of links and pictures, with their lines.
    pub(crate) fn links(&self) -> Vec<(usize, String)> {
        let mut links = Vec::new();
        for (number, line) in &self.lines {
            for (opens, closes) in [("](", ')'), ("src=\"", '"'), ("srcset=\"", '"')] {
                for rest in line.split(opens).skip(1) {
                    let (target, _) = rest.split_once(closes).unwrap_or((rest, ""));
                    links.push((*number, target.to_owned()));
                }
            }
        }
        links
    }

    /// The anchors of the headings, as GitHub makes them.
    pub(crate) fn anchors(&self) -> Vec<String> {
        let mut times = HashMap::<String, usize>::new();
        let headings = self.lines.iter().filter_map(|(_, line)| {
            let text = line.trim_start_matches('#');
            (text.len() < line.len()).then(|| text.strip_prefix(' '))?
        });
        let anchors = headings.map(|heading| {
            let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
            let anchor: String = heading.trim().to_lowercase().chars().filter(kept).collect();
            let anchor = anchor.replace(' ', "-");
            let earlier = times.entry(anchor.clone()).or_default();
            *earlier += 1;
            if *earlier == 1 { anchor } else { format!("{anchor}-{}", *earlier - 1) }
        });
        anchors.collect()
    }
}

/// The README, its pages, and what they lead to.
pub(crate) fn all() -> Vec<Page> {
    let mut paths = vec!["README.md".into(), "CONTRIBUTING.md".into(), "SECURITY.md".into()];
    paths.extend(pages_of("docs"));
    paths.push("benches/side_by_side/README.md".into());
    let mut deploy: Vec<PathBuf> =
        fs::read_dir("deploy").unwrap().map(|e| e.unwrap().path()).collect();
    deploy.sort();
    paths.extend(deploy.into_iter().filter(|folder| folder.is_dir()).flat_map(pages_of));
    paths.iter().map(|path| Page::read(path)).collect()
}

fn pages_of(folder: impl AsRef<Path>) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut pages: Vec<_> =
        entries.filter(|path| path.extension().is_some_and(|e| e == "md")).collect();
    pages.sort();
    pages
}
