//! The reference for editors against the functions themselves: their arguments one by one, what they
//! refuse, and what they return. So every function is also called with every wrong type and count.

mod rig;

use rig::{Bench, failed};
use script::NAMES;

struct Parameter {
    name: String,
    kind: String,
    optional: bool,
}

struct Function {
    name: String,
    parameters: Vec<Parameter>,
    returns: Option<String>,
}

/// Reads `stepfleet.lua`.
fn functions() -> Vec<Function> {
    let mut functions = Vec::new();
    let (mut parameters, mut returns) = (Vec::new(), None);
    for line in include_str!("../stepfleet.lua").lines() {
        if let Some(words) = line.strip_prefix("---@param ") {
            let mut words = words.split(' ');
            let name = words.next().expect("a name");
            parameters.push(Parameter {
                name: name.trim_end_matches('?').to_owned(),
                kind: words.next().expect("a type").to_owned(),
                optional: name.ends_with('?'),
            });
        } else if let Some(words) = line.strip_prefix("---@return ") {
            returns = words.split(' ').next().map(String::from);
        } else if let Some(signature) = line.strip_prefix("function ") {
            let (name, list) = signature.split_once('(').expect("a list");
            let list = list.strip_suffix(") end").expect("its end");
            let named: Vec<&str> = parameters
                .iter()
                .map(|parameter: &Parameter| parameter.name.as_str())
                .collect();
            assert_eq!(named.join(", "), list, "{name}");
            functions.push(Function {
                name: name.to_owned(),
                parameters: core::mem::take(&mut parameters),
                returns: returns.take(),
            });
        } else if !line.starts_with("---") {
            parameters.clear();
            returns = None;
        }
    }
    assert_eq!(functions.len(), NAMES.len());
    functions
}

/// A value that this parameter takes.
fn good(function: &Function, parameter: &Parameter) -> &'static str {
    match (function.name.as_str(), parameter.name.as_str()) {
        (_, "axis") => "0",
        ("input.read", _) => "'stop'",
        ("node.call", "name") => "'stored'",
        ("motor.queue_line", "steps") => "{1, 2}",
        // It rises from the start's speed, 1, over more than a step.
        ("motor.queue_smooth_ramp" | "motor.queue_smooth_ramp_to", "speed_hz" | "ramp_steps") => {
            "2"
        }
        _ => match parameter.kind.as_str() {
            "integer" | "CommandId" | "1|-1" => "1",
            "string" => "'a'",
            "boolean" => "true",
            "RampOptions" => "{}",
            "any" => "{1}",
            other => panic!("{}: a new type {other}", function.name),
        },
    }
}

/// Values that a parameter of this type does not take.
fn bad(parameter: &Parameter) -> Vec<&'static str> {
    let mut bad = match parameter.kind.as_str() {
        "integer" | "CommandId" | "1|-1" => vec![
            "{}",
            "true",
            "'x'",
            "'1'",
            "print",
            "1.5",
            "0/0",
            "1/0",
            "-1/0",
            "1e30",
            "coroutine.create(print)",
        ],
        "string" => vec!["{}", "true", "7", "print", "''", "('x'):rep(65)"],
        "boolean" => vec!["{}", "1", "'true'", "print"],
        "integer[]" => vec![
            "{}",
            "true",
            "5",
            "'x'",
            "print",
            "{'a'}",
            "{1.5}",
            "{1, 2, 3, 4, 5}",
        ],
        "RampOptions" => vec![
            "true",
            "5",
            "'x'",
            "print",
            "{jrk = 1}",
            "{1}",
            "{jerk = 'a'}",
            "{unit = 'rpm'}",
            "{unit = 5}",
            "{passing = 0.5}",
        ],
        "any" => return Vec::new(),
        other => panic!("a new type {other}"),
    };
    if !parameter.optional {
        bad.push("nil");
    }
    bad
}

fn goods(function: &Function) -> Vec<&'static str> {
    let parameters = function.parameters.iter();
    parameters
        .map(|parameter| good(function, parameter))
        .collect()
}

#[test]
fn every_function_refuses_every_wrong_type_and_names_the_argument() {
    let mut calls = 0;
    for function in functions() {
        for (place, parameter) in function.parameters.iter().enumerate() {
            for value in bad(parameter) {
                let mut values = goods(&function);
                values[place] = value;
                let call = format!("{}({})", function.name, values.join(", "));
                let mut bench = Bench::default();
                bench.stored.push(("stored".into(), "return 1".into()));
                let message = bench.failed(&call);
                let words = format!("test:1: {}: {}", function.name, parameter.name);
                assert!(message.starts_with(&words), "{call}: {message}");
                assert!(bench.commands.is_empty(), "{call} moved something");
                calls += 1;
            }
        }
    }
    println!("{calls} calls");
    assert!(calls > 400);
}

#[test]
fn every_function_refuses_too_few_and_too_many_arguments() {
    for function in functions() {
        let name = &function.name;
        let values = goods(&function);
        let more = [&values[..], &["1"]].concat().join(", ");
        let message = failed(&format!("{name}({more})"));
        let words = format!("test:1: {name} takes ");
        assert!(message.starts_with(&words), "{name}({more}): {message}");
        let required = function
            .parameters
            .iter()
            .filter(|parameter| !parameter.optional);
        // What may be anything may be nothing.
        let required: Vec<_> = required
            .filter(|parameter| parameter.kind != "any")
            .collect();
        for count in 0..required.len() {
            let call = format!("{name}({})", values[..count].join(", "));
            let message = failed(&call);
            let named = |missing: &&Parameter| {
                let words = format!("test:1: {name}: {}", missing.name);
                message.starts_with(&words)
            };
            assert!(required[count..].iter().any(named), "{call}: {message}");
        }
    }
}

#[test]
fn every_function_returns_what_the_reference_says() {
    for function in functions() {
        let name = function.name.as_str();
        let call = format!("{name}({})", goods(&function).join(", "));
        let check = match function.returns.as_deref() {
            // It ends the script.
            _ if name == "motor.emergency_stop" => continue,
            // This bench has no switches.
            _ if name == "motor.queue_home" => continue,
            // Whatever the script returns.
            Some("any") => continue,
            None => format!("return select('#', {call}) == 0"),
            Some("integer" | "CommandId") => format!("return math.type({call}) == 'integer'"),
            Some("integer?") => {
                format!("local v = {call} return v == nil or math.type(v) == 'integer'")
            }
            Some("number") => format!("return type({call}) == 'number'"),
            Some("boolean") => format!("return type({call}) == 'boolean'"),
            Some("NodeStatus") => format!("return type({call}) == 'table'"),
            Some(other) => panic!("{name}: a new type {other}"),
        };
        let told = match name {
            "motor.is_done" => Bench::default().returned(&format!("motor.queue_pause(1) {check}")),
            _ => Bench::default().returned(&check),
        };
        assert_eq!(told, "true", "{call}");
    }
}

#[test]
fn the_status_has_the_fields_of_the_reference_and_no_others() {
    let mut documented = Vec::new();
    let mut of_status = false;
    for line in include_str!("../stepfleet.lua").lines() {
        if let Some(class) = line.strip_prefix("---@class ") {
            of_status = class == "NodeStatus";
        } else if let Some(field) = line.strip_prefix("---@field ").filter(|_| of_status) {
            let name = field.split(' ').next().expect("a name");
            documented.push(name.trim_end_matches('?').to_owned());
        }
    }
    documented.sort();
    let text = "lidar.read() local names = {} for name in pairs(node.status()) do names[#names + 1] = name end
        table.sort(names) return table.concat(names, ' ')";
    let told = Bench::default().returned(text);
    assert_eq!(told.trim_matches('"'), documented.join(" "));
}
