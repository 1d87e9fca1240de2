//! Detects incomplete frames, and raises the capacity of their lists.
//!
//! A pass may write a list whose length only the device knows. The list's capacity is a constant parameter of the graph
//! that `grows` with a statistic: the number of entries that the frame needed. If the statistic exceeds the parameter,
//! the list overflowed, and the frame contains only the entries that fitted. [`overflows`] detects this.
//! [`Capacities`] stores the minimum values of such parameters for the next plan: the need plus a quarter, or the need
//! alone if the device has no room for more.

use splatgraph_assets::grouped;
use splatgraph_framework::ir::{Domain, Stat, Value};
use splatgraph_framework::plan::Plan;
use std::fmt;

/// Overflow of a list in a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Overflow {
    /// Name of the parameter that is the list's capacity.
    pub parameter: String,
    /// The parameter's value in the frame's plan: the number of entries that were drawn.
    pub room: i64,
    /// Number of entries that the frame needed.
    pub needed: i64,
    /// Maximum of the parameter's range.
    pub most: i64,
}

impl Overflow {
    /// Returns the new capacity: the need plus a quarter, limited to the parameter's range.
    pub fn target(&self) -> i64 {
        self.needed.saturating_add(self.needed / 4).min(self.most)
    }
}

impl fmt::Display for Overflow {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let number = |n: i64| grouped(n.unsigned_abs());
        write!(f, "{} of {} {}", number(self.room), number(self.needed), self.parameter.replace('_', " "))
    }
}

/// Lists the overflows in a frame of `plan`. `stats` are the frame's statistics by name.
pub fn overflows(plan: &Plan, stats: &[(String, u32)]) -> Vec<Overflow> {
    let of = |param: &splatgraph_framework::ir::Param| {
        let grows = |stat: &&Stat| stat.grows.contains(&param.name);
        let value = |stat: &Stat| stats.iter().find(|(name, _)| *name == stat.name).map(|(_, value)| value);
        let needed = plan.stats.iter().filter(grows).filter_map(value).max()?;
        match (&param.value, &param.domain) {
            (Value::Int(room), Domain::Int { max, .. }) if i64::from(*needed) > *room => Some(Overflow {
                parameter: param.name.clone(),
                room: *room,
                needed: (*needed).into(),
                most: *max,
            }),
            _ => None,
        }
    };
    plan.params.iter().filter_map(of).collect()
}

/// Minimum values of growing parameters, raised when earlier frames overflowed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capacities(Vec<(String, i64)>);

impl Capacities {
    /// Raises the minimum for a list that overflowed. Returns false if it is already sufficient or cannot be raised.
    pub fn raise(&mut self, short: &Overflow) -> bool {
        let target = short.target();
        match self.0.iter_mut().find(|(name, _)| *name == short.parameter) {
            // Several frames in flight may report the same overflow.
            Some((_, least)) if *least >= short.needed.min(short.most) => false,
            Some((_, least)) => {
                *least = target;
                true
            }
            None if target <= short.room => false,
            None => {
                self.0.push((short.parameter.clone(), target));
                true
            }
        }
    }

    /// Lowers the minimums of these lists to their exact needs, for a device that has no room for more.
    pub fn tighten(&mut self, short: &[&Overflow]) {
        for (name, least) in &mut self.0 {
            if let Some(short) = short.iter().find(|short| short.parameter == *name) {
                *least = short.needed.min(short.most);
            }
        }
    }

    /// Removes the minimum of a parameter, so that its default applies again.
    pub fn forget(&mut self, parameter: &str) {
        self.0.retain(|(name, _)| name != parameter);
    }

    /// Returns the minimum values by parameter, for [`splatgraph_framework::ir::Request::capacities`].
    pub fn values(&self) -> &[(String, i64)] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::planner::testing;

    fn short(room: i64, needed: i64) -> Overflow {
        Overflow { parameter: "tile_entries".into(), room, needed, most: 10_000 }
    }

    #[test]
    fn a_parameter_must_cover_the_largest_of_its_statistics() {
        let mut plan = testing::plan("tiled", &[], 32);
        let first = plan.stats.iter().find(|stat| !stat.grows.is_empty()).expect("a statistic").clone();
        let other = Stat { name: format!("b.{}", first.name), ..first.clone() };
        plan.stats.push(other.clone());
        let needed = |stats: [u32; 2]| {
            let stats = [(first.name.clone(), stats[0]), (other.name.clone(), stats[1])];
            overflows(&plan, &stats).iter().map(|short| short.needed).collect::<Vec<_>>()
        };
        assert_eq!(needed([5, u32::MAX]), [i64::from(u32::MAX)]);
        assert_eq!(needed([u32::MAX, 5]), [i64::from(u32::MAX)]);
        assert!(needed([5, 5]).is_empty());
    }

    #[test]
    fn a_parameter_grows_to_the_need_and_a_quarter_within_its_range() {
        let mut capacities = Capacities::default();
        assert!(capacities.raise(&short(100, 1000)));
        assert_eq!(capacities.values(), [("tile_entries".to_owned(), 1250)]);
        assert!(
            !capacities.raise(&short(100, 1200)),
            "a frame of the former plan, for which there is room now"
        );
        assert!(capacities.raise(&short(1250, 1300)));
        assert_eq!(capacities.values()[0].1, 1625);
        capacities.tighten(&[&short(1250, 1300)]);
        assert_eq!(capacities.values()[0].1, 1300, "the need");
        assert!(capacities.raise(&short(1300, 9000)));
        assert_eq!(capacities.values()[0].1, 10_000, "the end of the range");
        assert!(!capacities.raise(&short(10_000, 20_000)), "there is no more");
        capacities.forget("tile_entries");
        assert_eq!(capacities, Capacities::default());
        assert!(!capacities.raise(&short(10_000, 20_000)), "nor after a setting to the end of the range");
    }

    #[test]
    fn a_shortage_names_what_was_drawn_and_what_was_needed() {
        assert_eq!(short(1234, 5678).to_string(), "1,234 of 5,678 tile entries");
    }
}
