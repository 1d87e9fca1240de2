//! Parses the options of the exact renderer.

use crate::draw::truth::rule_list;

pub fn rule_help() -> String {
    format!(
        "Change a rule of the exact renderer; may be repeated\n\nThe rules, with their values and their place in the published rasteriser:\n{}",
        crate::cli::help::two_columns(rule_list())
    )
}
