//! Vocabularies of DBoW2 and DBoW3 as OpenCV's YAML: `vocabulary:` with `k`, `L`, a list of `nodes`
//! and one of `words`.
//!
//! Nodes are numbered from 1 and may be in any order; 0 is the root. Children are compared in the
//! order of the file, as DBoW2 does. Words get the numbers that DBoW2 gives them in training: the
//! children of a node follow each other, then come those below its first child.

mod error;
mod nodes;
mod scanner;

use crate::quantizer::{DescentTree, MAX_BRANCHING, MAX_DEPTH};
use nodes::Nodes;
use scanner::{Scanner, Token};

use super::ORB_BYTES;
pub use error::DbowYamlError;

/// Reads the whole text.
pub(super) fn parse(text: &str) -> Result<DescentTree, DbowYamlError> {
    let mut scanner = Scanner::new(text);
    if scanner.name("`vocabulary`")? != "vocabulary" {
        return Err(scanner.unexpected("`vocabulary`"));
    }
    let (mut branching, mut depth) = (None, None);
    let mut nodes = Nodes::default();
    let (mut has_nodes, mut has_words) = (false, false);
    while let Some(key) = scanner.name_or_end()? {
        match key {
            "k" => branching = Some(ranged(&mut scanner, "k (children of a node)", 2, MAX_BRANCHING)?),
            "L" => depth = Some(ranged(&mut scanner, "L (levels)", 1, MAX_DEPTH)?),
            "scoringType" => {
                ranged(&mut scanner, "scoringType", 0, 5)?;
            }
            "weightingType" => {
                ranged(&mut scanner, "weightingType", 0, 3)?;
            }
            "nodes" => {
                has_nodes = true;
                list(&mut scanner, |scanner| node(scanner, &mut nodes))?;
            }
            "words" => {
                has_words = true;
                list(&mut scanner, |scanner| word(scanner, &mut nodes))?;
            }
            _ => return Err(scanner.unexpected("k, L, scoringType, weightingType, nodes or words")),
        }
    }
    let missing = |name| DbowYamlError::Missing { name };
    let branching = branching.ok_or_else(|| missing("k"))?;
    let depth = depth.ok_or_else(|| missing("L"))?;
    for (name, is_there) in [("nodes", has_nodes), ("words", has_words)] {
        if !is_there {
            return Err(missing(name));
        }
    }
    nodes.tree(branching, depth, &|at| scanner.line_of(at))
}

/// A number of the head, which must lie in its range.
fn ranged(
    scanner: &mut Scanner<'_>,
    name: &'static str,
    lowest: usize,
    highest: usize,
) -> Result<usize, DbowYamlError> {
    let found = scanner.number::<usize>("a whole number")?;
    if (lowest..=highest).contains(&found) {
        Ok(found)
    } else {
        Err(DbowYamlError::Range { line: scanner.line(), name, found, lowest, highest })
    }
}

/// Reads items, `- { … }` or `[ { … }, { … } ]`, each by `read`, which begins behind the brace.
fn list<'a>(
    scanner: &mut Scanner<'a>,
    mut read: impl FnMut(&mut Scanner<'a>) -> Result<(), DbowYamlError>,
) -> Result<(), DbowYamlError> {
    let in_brackets = scanner.take(Token::Open);
    loop {
        let begins = if in_brackets {
            let _ = scanner.take(Token::Comma);
            !scanner.take(Token::Close)
        } else {
            scanner.take(Token::Dash)
        };
        if !begins {
            return Ok(());
        }
        scanner.expect(Token::OpenBrace, "`{`")?;
        read(scanner)?;
    }
}

/// Reads the fields of an item, `key: value, … }`, each by `read`, which begins behind the colon.
fn fields<'a>(
    scanner: &mut Scanner<'a>,
    mut read: impl FnMut(&mut Scanner<'a>, &str) -> Result<(), DbowYamlError>,
) -> Result<(), DbowYamlError> {
    loop {
        let name = scanner.name("the name of a field")?;
        read(scanner, name)?;
        if !scanner.take(Token::Comma) {
            return scanner.expect(Token::CloseBrace, "`,` or `}`");
        }
    }
}

fn node(scanner: &mut Scanner<'_>, nodes: &mut Nodes) -> Result<(), DbowYamlError> {
    let at = scanner.position();
    let (mut id, mut parent, mut row) = (None, None, None);
    fields(scanner, |scanner, key| {
        match key {
            "nodeId" => id = Some(scanner.number("the number of a node")?),
            "parentId" => parent = Some(scanner.number("the number of a node")?),
            // It belongs to DBoW2's scoring.
            "weight" => {
                scanner.number::<f64>("a weight")?;
            }
            "descriptor" => row = Some(descriptor(scanner)?),
            _ => return Err(scanner.unexpected("nodeId, parentId, weight or descriptor")),
        }
        Ok(())
    })?;
    let (Some(id), Some(parent), Some(row)) = (id, parent, row) else {
        return Err(DbowYamlError::Item {
            line: scanner.line_of(at),
            needs: "a nodeId, parentId and descriptor",
        });
    };
    nodes.add_node(id, parent, &row, at);
    Ok(())
}

fn word(scanner: &mut Scanner<'_>, nodes: &mut Nodes) -> Result<(), DbowYamlError> {
    let at = scanner.position();
    let (mut word, mut node) = (None, None);
    fields(scanner, |scanner, key| {
        match key {
            "wordId" => word = Some(scanner.number("the number of a word")?),
            "nodeId" => node = Some(scanner.number("the number of a node")?),
            _ => return Err(scanner.unexpected("wordId or nodeId")),
        }
        Ok(())
    })?;
    let (Some(word), Some(node)) = (word, node) else {
        return Err(DbowYamlError::Item { line: scanner.line_of(at), needs: "a wordId and a nodeId" });
    };
    nodes.add_word(word, node, at);
    Ok(())
}

/// The bytes of a descriptor as text: DBoW2's bytes alone, or DBoW3's with OpenCV's type and the
/// number of columns before them, and the mark `dbw3` before these in its later versions.
fn descriptor(scanner: &mut Scanner<'_>) -> Result<[u8; ORB_BYTES], DbowYamlError> {
    let text = scanner.text("a descriptor")?.trim_ascii();
    let line = scanner.line();
    let mut numbers = text.split_ascii_whitespace();
    let marked = text.starts_with("dbw3");
    if marked {
        numbers.next();
    }
    let count = numbers.clone().count();
    let has_head = marked || count == ORB_BYTES + 2;
    if has_head {
        let mut head = || numbers.next().and_then(|number| number.parse::<u32>().ok());
        match (head(), head()) {
            (Some(0), Some(columns)) if columns as usize == count.saturating_sub(2) => {}
            (Some(0), Some(_)) => return Err(DbowYamlError::DescriptorCut { line }),
            (Some(_), _) => return Err(DbowYamlError::NotBinary { line }),
            (None, _) => return Err(DbowYamlError::Descriptor { line, found: scanner::beginning(text) }),
        }
    }
    let bytes = numbers.clone().count();
    if numbers.clone().any(|number| number.contains(['.', 'e'])) {
        return Err(DbowYamlError::NotBinary { line });
    }
    if bytes != ORB_BYTES {
        return Err(DbowYamlError::DescriptorBytes { line, bytes });
    }
    let mut row = [0; ORB_BYTES];
    for (byte, number) in row.iter_mut().zip(numbers) {
        *byte = number
            .parse()
            .map_err(|_| DbowYamlError::Descriptor { line, found: scanner::beginning(number) })?;
    }
    Ok(row)
}

#[cfg(test)]
pub(super) mod tests;
