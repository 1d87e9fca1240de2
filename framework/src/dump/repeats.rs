//! Finds the passes of each repeat.
//!
//! The plan is flat: a repeat's body appears once per iteration. Pass names contain the index: `sort.scatter[3]`,
//! `level[1].blur` if the body is an include, `tile[0][2]` for nested repeats. Recovering the repeats from the names
//! keeps them out of the backends' input.

use super::form::{DumpPass, DumpRepeat, Iteration};
use std::collections::{BTreeSet, HashMap};

#[derive(Debug, PartialEq, Eq)]
struct Parts<'a> {
    /// The text up to the last dot before the first index: the include that contains the repeat.
    scope: &'a str,
    member: String,
    index: Vec<u32>,
}

/// Splits a pass's name; `None` if it has no index, or text between brackets is not a number.
fn parts(name: &str) -> Option<Parts<'_>> {
    let (before, _) = name.split_once('[')?;
    let scope = before.rsplit_once('.').map_or("", |(scope, _)| scope);
    let mut member = String::new();
    let mut index = Vec::new();
    let mut rest = name;
    while let Some((text, after)) = rest.split_once('[') {
        let (number, after) = after.split_once(']')?;
        member += text;
        index.push(number.parse().ok()?);
        rest = after;
    }
    Some(Parts { scope, member: member + rest, index })
}

/// Splits the index off a name: `sort.scan[3]` gives `sort.scan[]` and 3. `None` unless there is exactly one index.
pub fn single_index(name: &str) -> Option<(String, u32)> {
    let (before, rest) = name.split_once('[')?;
    let (number, after) = rest.split_once(']')?;
    if after.contains('[') {
        return None;
    }
    Some((format!("{before}[]{after}"), number.parse().ok()?))
}

/// Records in each pass the repeat that it belongs to, and lists the repeats.
///
/// A repeat is a run of consecutive passes in one part of the plan and one scope. A falling outermost index starts
/// another repeat. A single iteration does not count as a repeat.
pub fn find(passes: &mut [DumpPass]) -> Vec<DumpRepeat> {
    let mut repeats: Vec<DumpRepeat> = Vec::new();
    let mut taken = HashMap::new();
    let mut first = 0;
    while first < passes.len() {
        let Some(head) = parts(&passes[first].name) else {
            first += 1;
            continue;
        };
        let (scope, mut latest) = (head.scope.to_owned(), head.index[0]);
        let run = passes[first].run;
        let mut members = Vec::new();
        for pass in passes[first..].iter().take_while(|p| p.run == run) {
            match parts(&pass.name) {
                Some(next) if next.scope == scope && next.index[0] >= latest => {
                    latest = next.index[0];
                    members.push((next.member, next.index));
                }
                _ => break,
            }
        }
        let indices: BTreeSet<&[u32]> = members.iter().map(|(_, index)| index.as_slice()).collect();
        // A pass beside an inner repeat adds no iteration. Its index is a prefix of the inner indices, and sorts just
        // before them.
        let ordered: Vec<&[u32]> = indices.into_iter().collect();
        let outer = ordered.windows(2).filter(|pair| pair[1].starts_with(pair[0])).count();
        let (iterations, count) = (ordered.len() - outer, members.len());
        if iterations > 1 {
            let wanted = if scope.is_empty() { members[0].0.clone() } else { scope };
            let name = unique(wanted, &mut taken);
            repeats.push(DumpRepeat { name: name.clone(), iterations, first, passes: count });
            for (pass, (member, index)) in passes[first..].iter_mut().zip(members) {
                pass.repeat = Some(Iteration { group: name.clone(), member, index });
            }
        }
        first += count;
    }
    repeats
}

/// Makes a name unique: `sort`, or `sort (2)` if `sort` exists. `taken` maps each name so far to the next number, and
/// gets the new name.
fn unique(wanted: String, taken: &mut HashMap<String, u32>) -> String {
    let mut name = wanted.clone();
    while taken.contains_key(&name) {
        let number = taken.entry(wanted.clone()).or_insert(2);
        name = format!("{wanted} ({number})");
        *number += 1;
    }
    taken.insert(name.clone(), 2);
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_taken_apart_into_scope_member_and_indices() {
        let expected = |scope, member: &str, index: &[u32]| {
            Some(Parts { scope, member: member.into(), index: index.to_vec() })
        };
        assert_eq!(parts("sort.scatter[3]"), expected("sort", "sort.scatter", &[3]));
        assert_eq!(parts("level[1].blur.row[0]"), expected("", "level.blur.row", &[1, 0]));
        assert_eq!(parts("a.b.tile[0][12]"), expected("a.b", "a.b.tile", &[0, 12]));
        assert_eq!(parts("project"), None);
        assert_eq!(parts("odd[x]"), None, "not an index");
    }
}
