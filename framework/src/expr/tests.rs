use std::collections::BTreeMap;

use proptest::prelude::*;

use super::tree::{BinaryOp, Function};
use super::*;

fn scope() -> BTreeMap<String, Value> {
    [
        ("n", Value::Int(1_000_000)),
        ("digits", Value::Int(4)),
        ("scene.count", Value::Int(4097)),
        ("cutoff", Value::Float(3.33)),
        ("sort", Value::Bool(true)),
        ("blend", Value::Text("over".into())),
        ("min_int", Value::Int(i64::MIN)),
        ("max_int", Value::Int(i64::MAX)),
        ("infinite", Value::Float(f64::INFINITY)),
        ("nan", Value::Float(f64::NAN)),
    ]
    .map(|(name, value)| (name.to_string(), value))
    .into()
}

fn eval(text: &str) -> Result<Value, ExprError> {
    Expr::parse(text)?.eval(&scope())
}

#[track_caller]
fn int(text: &str, expected: i64) {
    assert_eq!(eval(text), Ok(Value::Int(expected)), "{text}");
}

#[track_caller]
fn float(text: &str, expected: f64) {
    assert_eq!(eval(text), Ok(Value::Float(expected)), "{text}");
}

#[track_caller]
fn truth(text: &str, expected: bool) {
    assert_eq!(eval(text), Ok(Value::Bool(expected)), "{text}");
}

/// Checks the error's message, and the part of the text that it points at. Returns the error's help.
#[track_caller]
fn fails(text: &str, message: &str, at: &str) -> Option<String> {
    let error = eval(text).expect_err(text);
    assert_eq!((error.message.as_str(), &text[error.start..error.end]), (message, at), "{text}");
    error.help
}

#[test]
fn the_tables_are_in_the_order_of_their_variants() {
    for (i, entry) in BinaryOp::TABLE.iter().enumerate() {
        assert_eq!(entry.0 as usize, i);
    }
    for (i, entry) in Function::TABLE.iter().enumerate() {
        assert_eq!(entry.0 as usize, i);
    }
}

#[test]
fn literals_are_values_of_four_types() {
    int("12", 12);
    int("1_000_000", 1_000_000);
    int("0x1f", 31);
    int("0b101", 5);
    float("1.5", 1.5);
    float(".5", 0.5);
    float("1e-3", 0.001);
    truth("true", true);
    truth("false", false);
    assert_eq!(eval("'back_to_front'"), Ok(Value::Text("back_to_front".into())));
    assert_eq!(eval("''"), Ok(Value::Text(String::new())));
}

#[test]
fn the_smallest_and_the_largest_integer_can_be_written() {
    int("-9223372036854775808", i64::MIN);
    int("9223372036854775807", i64::MAX);
    int("0x7fff_ffff_ffff_ffff", i64::MAX);
    fails("9223372036854775808", "this integer does not fit in 64 bits", "9223372036854775808");
    fails("1 + -9223372036854775809", "this integer does not fit in 64 bits", "9223372036854775809");
    fails("99999999999999999999", "this integer does not fit in 64 bits", "99999999999999999999");
}

#[test]
fn multiplication_binds_tighter_than_addition() {
    int("2 + 3 * 4", 14);
    int("(2 + 3) * 4", 20);
    int("20 - 12 / 4", 17);
    int("7 % 4 + 1", 4);
}

#[test]
fn addition_binds_tighter_than_shifts_and_shifts_tighter_than_comparisons() {
    int("1 << 2 + 1", 8);
    truth("1 << 4 > 15", true);
    truth("16 >> 2 == 4", true);
}

#[test]
fn comparisons_bind_tighter_than_equality_and_equality_tighter_than_logic() {
    truth("1 < 2 == true", true);
    truth("1 == 1 && 2 == 2", true);
    truth("true || true && false", true);
    truth("(true || true) && false", false);
    truth("!false && false", false);
}

#[test]
fn operators_of_one_level_group_from_left_to_right() {
    int("10 - 3 - 2", 5);
    int("100 / 10 / 5", 2);
    int("100 / 10 * 5", 50);
    int("1 << 2 << 3", 32);
}

#[test]
fn a_choice_groups_from_right_to_left_and_binds_loosest() {
    int("true ? 1 : false ? 2 : 3", 1);
    int("false ? 1 : false ? 2 : 3", 3);
    int("false || true ? 1 + 1 : 0", 2);
    int("true ? false ? 1 : 2 : 3", 2);
}

#[test]
fn minus_and_not_can_be_repeated() {
    int("--5", 5);
    int("- -n", 1_000_000);
    int("3 - -2", 5);
    int("-2 * -3", 6);
    truth("!!sort", true);
}

#[test]
fn integer_division_truncates_and_the_remainder_has_the_sign_of_the_dividend() {
    int("7 / 2", 3);
    int("-7 / 2", -3);
    int("-7 % 2", -1);
    int("7 % -2", 1);
    int("min_int % -1", 0);
}

#[test]
fn an_integer_beside_a_float_becomes_a_float() {
    float("1 + 0.5", 1.5);
    float("3 / 2.0", 1.5);
    float("7.5 % 2", 1.5);
    truth("2 == 2.0", true);
    truth("2 < 2.5", true);
}

#[test]
fn names_come_from_the_scope_and_may_have_dots() {
    int("scene.count - 1", 4096);
    truth("blend == 'over'", true);
    truth("blend != 'under'", true);
    float("cutoff", 3.33);
}

#[test]
fn every_use_of_a_name_is_listed_with_its_place() {
    let text = "ceil_div(scene.count, n) + (sort ? n : -digits) * float(n)";
    let expr = Expr::parse(text).unwrap();
    let names: Vec<_> = expr.names().map(|(name, place)| (name, text[place.clone()].to_string())).collect();
    let expected = ["scene.count", "n", "sort", "n", "digits", "n"].map(|n| (n, n.to_string()));
    assert_eq!(names, expected);
}

#[test]
fn the_constants_of_an_expression_are_its_largest_parts_without_names() {
    let parsed = Expr::parse("48 << 10 < 2 * n && mode == 'mip' && !wide").expect("valid");
    assert_eq!(parsed.constants(), [Value::Int(49152), Value::Int(2), Value::Text("mip".into())]);
}

#[test]
fn ceil_div_rounds_up_for_every_pair_of_signs() {
    int("ceil_div(scene.count, 4096)", 2);
    int("ceil_div(4096, 4096)", 1);
    int("ceil_div(0, 4096)", 0);
    for a in -20i64..=20 {
        for b in (-7i64..=7).filter(|b| *b != 0) {
            int(&format!("ceil_div({a}, {b})"), (a as f64 / b as f64).ceil() as i64);
        }
    }
    fails("ceil_div(n, 4 - digits)", "division by zero", "4 - digits");
    fails("ceil_div(min_int, -1)", "the result does not fit in a 64-bit integer", "ceil_div(min_int, -1)");
    fails("ceil_div(n, 2.0)", "`ceil_div` needs an integer, and this is a float", "2.0");
}

#[test]
fn min_and_max_take_any_number_of_arguments() {
    int("min(3)", 3);
    int("min(3, 1, 2)", 1);
    int("max(3, 1, 4)", 4);
    float("max(3, 1.5)", 3.0);
    float("min(3, 1.5, 2)", 1.5);
    fails("max(1, 'a')", "`max` needs a number, and this is a string", "'a'");
}

#[test]
fn clamp_keeps_a_value_in_its_range() {
    int("clamp(5, 1, 3)", 3);
    int("clamp(-5, 1, 3)", 1);
    float("clamp(2, 1.0, 3)", 2.0);
    fails("clamp(5, 3, 1)", "the range of this `clamp` is empty: 3 is above 1", "3, 1");
    fails("clamp(5, 3.5, 1)", "the range of this `clamp` is empty: 3.5 is above 1", "3.5, 1");
}

#[test]
fn log2_ceil_is_the_smallest_power_that_reaches() {
    for (n, log) in [(1, 0), (2, 1), (3, 2), (4, 2), (5, 3), (1 << 62, 62), (i64::MAX, 63)] {
        int(&format!("log2_ceil({n})"), log);
    }
    fails("log2_ceil(n - n)", "`log2_ceil` needs an integer from 1 on, not 0", "n - n");
}

#[test]
fn abs_float_and_int_convert() {
    int("abs(-3)", 3);
    float("abs(-3.5)", 3.5);
    float("float(3)", 3.0);
    float("float(true)", 1.0);
    int("int(3.9)", 3);
    int("int(-3.9)", -3);
    int("int(sort)", 1);
    int("int(-9223372036854775808.0)", i64::MIN);
    fails(
        "int(9223372036854775808.0)",
        "the result does not fit in a 64-bit integer",
        "int(9223372036854775808.0)",
    );
    fails("int(nan)", "the result does not fit in a 64-bit integer", "int(nan)");
    fails("abs(min_int)", "the result does not fit in a 64-bit integer", "abs(min_int)");
    fails("int('7')", "`int` needs a number, and this is a string", "'7'");
}

#[test]
fn integer_overflow_is_an_error_at_the_operation() {
    let message = "the result does not fit in a 64-bit integer";
    fails("1 + (max_int + 1)", message, "max_int + 1");
    fails("(max_int) + (1)", message, "(max_int) + (1)");
    fails("min_int - 1", message, "min_int - 1");
    fails("max_int * 2", message, "max_int * 2");
    fails("min_int / -1", message, "min_int / -1");
    fails("-min_int", message, "-min_int");
    fails("1 << 63", message, "1 << 63");
    fails("max_int << 1", message, "max_int << 1");
}

#[test]
fn shifts_are_by_0_to_63() {
    int("1 << 62", 1 << 62);
    int("-1 << 63", i64::MIN);
    int("max_int >> 63", 0);
    int("-8 >> 1", -4);
    int("5 << 0", 5);
    int("0 << 63", 0);
    fails("1 << 64", "a shift by 64: it must be from 0 to 63", "64");
    fails("1 >> (0 - 1)", "a shift by -1: it must be from 0 to 63", "0 - 1");
    fails("1.5 << 2", "`<<` needs an integer, and this is a float", "1.5");
    let help = fails("1 >> cutoff", "`>>` needs an integer, and this is a float", "cutoff");
    assert_eq!(help.as_deref(), Some("`int(x)` truncates the fraction"));
}

#[test]
fn division_by_zero_is_an_error_at_the_divisor() {
    fails("n / 0", "division by zero", "0");
    fails("n % (digits - 4)", "division by zero", "digits - 4");
    fails("1.5 / 0.0", "division by zero", "0.0");
    fails("1.5 % 0", "division by zero", "0");
}

#[test]
fn floats_never_become_infinite() {
    fails("1e308 * 10", "the result is not a finite number", "1e308 * 10");
    fails("1e308 + 1e308", "the result is not a finite number", "1e308 + 1e308");
    fails("infinite - 1", "the result is not a finite number", "infinite - 1");
    fails("1e999", "this float is too large", "1e999");
}

#[test]
fn nothing_compares_with_nan_but_unequal() {
    truth("nan < 1", false);
    truth("nan >= 1", false);
    truth("nan == nan", false);
    truth("nan != nan", true);
}

#[test]
fn wrong_types_are_errors_at_the_operand() {
    fails("1 + 'a'", "`+` needs a number, and this is a string", "'a'");
    fails("sort * 2", "`*` needs a number, and this is a bool", "sort");
    fails("-sort", "`-` needs a number, and this is a bool", "sort");
    fails("'a' < 'b'", "`<` needs a number, and this is a string", "'a'");
    let help = fails("1 < 2 < 3", "`<` needs a number, and this is a bool", "1 < 2");
    assert_eq!(help.as_deref(), Some("`a < b < c` is written `a < b && b < c`"));
    fails("blend == 1", "`==` compares a string with an integer", "1");
    fails("sort != 1", "`!=` compares a bool with an integer", "1");
    let help = fails("n && sort", "`&&` needs a bool, and this is an integer", "n");
    assert_eq!(help.as_deref(), Some("compare it, for instance with `!= 0`"));
    fails("!blend", "`!` needs a bool, and this is a string", "blend");
}

#[test]
fn what_is_not_reached_is_not_evaluated() {
    truth("false && 1 / 0 == 1", false);
    truth("true || nothing", true);
    int("true ? 1 : 1 / 0", 1);
    int("n == 0 ? 0 : n / n", 1);
    fails("true && 1 / 0 == 1", "division by zero", "0");
    fails("n ? 1 : 2", "the condition before `?` needs a bool, and this is an integer", "n");
}

#[test]
fn an_unknown_name_is_met_with_the_nearest_one() {
    let help = fails("2 * scene.cuont", "there is no value named `scene.cuont`", "scene.cuont");
    assert_eq!(help.as_deref(), Some("did you mean `scene.count`?"));
    let help = fails("abs", "there is no value named `abs`", "abs");
    assert_eq!(help.as_deref(), Some("`abs` is a function: write `abs(...)`"));
    let help = fails("entirely_else", "there is no value named `entirely_else`", "entirely_else");
    assert!(help.unwrap().starts_with("the names here are blend, cutoff, digits"));
}

#[test]
fn an_unknown_function_is_met_with_the_nearest_one() {
    let help = fails("ciel_div(1, 2)", "there is no function `ciel_div`", "ciel_div");
    assert_eq!(help.as_deref(), Some("did you mean `ceil_div`?"));
    let help = fails("transmogrify(1)", "there is no function `transmogrify`", "transmogrify");
    assert_eq!(
        help.as_deref(),
        Some("the functions are ceil_div, min, max, clamp, abs, log2_ceil, float, int")
    );
}

#[test]
fn wrong_numbers_of_arguments_are_errors_at_the_call() {
    fails("1 + ceil_div(n)", "`ceil_div` takes 2 arguments, not 1", "ceil_div(n)");
    fails("abs()", "`abs` takes 1 argument, not 0", "abs()");
    fails("min()", "`min` takes at least 1 argument, not 0", "min()");
    fails("clamp(1, 2)", "`clamp` takes 3 arguments, not 2", "clamp(1, 2)");
}

#[test]
fn syntax_errors_point_at_the_token() {
    fails("", "the expression is empty", "");
    fails("  ", "the expression is empty", "  ");
    fails("1 +", "expected a value, found the end of the expression", "");
    fails("1 + * 2", "expected a value, found `*`", "*");
    fails("1 2", "expected an operator, found `2`", "2");
    fails("n )", "this `)` closes nothing", ")");
    fails("2 * (n + 1", "this `(` is not closed", "(");
    fails("min(1, 2", "this `(` is not closed", "(");
    fails("min(1, 2 3)", "expected an operator or `)`, found `3`", "3");
    fails("min(1, )", "expected a value, found `)`", ")");
    fails("sort ? 1", "expected `:` and the alternative, found the end of the expression", "");
    fails("n.", "`n.` is not a name", "n.");
    fails("scene..count", "`scene..count` is not a name", "scene..count");
    fails("12ab", "`12ab` is not a number", "12ab");
    fails("1.2.3", "`1.2.3` is not a number", "1.2.3");
    fails("1.", "`1.` is not a number", "1.");
    fails("0x", "`0x` is not a number", "0x");
    fails("n + €", "unexpected `€`", "€");
}

#[test]
fn habits_from_other_languages_are_met_with_help() {
    let help = |text| eval(text).unwrap_err().help.unwrap_or_default();
    assert_eq!(help("n = 1"), "values are compared with `==`");
    for and in ["sort & sort", "sort and sort", "(sort and sort)"] {
        assert_eq!(help(and), "and is written `&&`");
    }
    for or in ["sort | sort", "sort or not sort"] {
        assert_eq!(help(or), "or is written `||`");
    }
    for not in ["not sort", "sort && not(sort)", "sort && not sort"] {
        assert_eq!(help(not), "not is written `!`");
    }
    assert_eq!(help("blend == \"over\""), "a string is written in single quotes: `'over'`");
    assert_eq!(help("blend == 'over"), "a string is written in single quotes: `'over'`");
    assert_eq!(help("2 ^ 8"), "a power of two is written `1 << n`");
}

#[test]
fn hostile_depth_is_an_error_and_not_a_stack_overflow() {
    let many = 200_000;
    let hostile = [
        "(".repeat(many),
        "-".repeat(many),
        "!".repeat(many),
        "abs(".repeat(many),
        "1+".repeat(many) + "1",
        "true?".repeat(many),
        "true?1:".repeat(many),
        "a||a&&a==a<a<<a+a*-(".repeat(many),
    ];
    for text in hostile {
        let error = Expr::parse(&text).unwrap_err();
        assert_eq!(error.message, "the expression is nested more than 128 levels deep", "{}", &text[..20]);
    }
}

#[test]
fn the_deepest_allowed_expressions_evaluate() {
    int(&("(".repeat(127) + "1" + &")".repeat(127)), 1);
    int(&("1+".repeat(127) + "1"), 128);
    truth(&("!".repeat(126) + "sort"), true);
    int(&("true?1:".repeat(127) + "2"), 1);
}

proptest! {
    #[test]
    fn no_text_makes_the_parser_or_the_evaluation_panic(text in ".*") {
        if let Err(error) = eval(&text) {
            prop_assert!(text.get(error.start..error.end).is_some(), "{error:?}");
        }
    }

    #[test]
    fn no_heap_of_tokens_makes_the_parser_or_the_evaluation_panic(
        tokens in prop::collection::vec(prop::sample::select(vec![
            "+", "-", "*", "/", "%", "<<", ">>", "==", "!=", "<", "<=", ">", ">=", "&&", "||", "!", "?", ":", "(",
            ")", ",", "n", "min_int", "max_int", "sort", "blend", "cutoff", "nan", "0", "1", "63", "64", "2.5", "'a'",
            "true", "min", "abs", "clamp", "ceil_div", "log2_ceil", "int", "float", ".", "'",
        ]), 0..24),
    ) {
        let text = tokens.join(" ");
        if let Err(error) = eval(&text) {
            prop_assert!(text.get(error.start..error.end).is_some(), "{error:?}");
        }
    }

    #[test]
    fn integer_arithmetic_agrees_with_128_bits(a: i64, b: i64, small in -100i64..100, op in 0usize..5) {
        for (a, b) in [(a, b), (a, small), (small, a)] {
            let (wide_a, wide_b) = (i128::from(a), i128::from(b));
            let expected = match op {
                0 => Some(wide_a + wide_b),
                1 => Some(wide_a - wide_b),
                2 => wide_a.checked_mul(wide_b),
                3 => wide_a.checked_div(wide_b),
                _ => wide_a.checked_rem(wide_b),
            };
            let expected = expected.and_then(|v| i64::try_from(v).ok()).map(Value::Int);
            let text = format!("{a} {} {b}", ["+", "-", "*", "/", "%"][op]);
            prop_assert_eq!(eval(&text).ok(), expected, "{}", text);
        }
    }
}
