//! Contact requests with extreme finite numbers: each is answered with finite numbers or an error
//! code, and none hangs. The values of the answers are not count_answered.

use serde_json::{Value, json};

use crate::ask::ask_text;

const EXTREME_NUMBERS: [f64; 14] =
    [5e-324, 1e-308, 1e-300, 1e-160, 1e-80, 1e-30, 1e-9, 1e9, 1e30, 1e80, 1e160, 1e300, 1e308, 0.0];

struct RandomNumbers(u64);

impl RandomNumbers {
    fn below(&mut self, count: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (self.0 >> 33) as usize % count
    }

    /// Usually the given number, sometimes an extreme one of either sign.
    fn number(&mut self, sound: f64) -> Value {
        if self.below(4) > 0 {
            return json!(sound);
        }
        let wild = EXTREME_NUMBERS[self.below(EXTREME_NUMBERS.len())];
        json!(if self.below(4) == 0 { -wild } else { wild })
    }

    /// Like `number`, with extreme numbers less often, for requests with many numbers.
    fn usually(&mut self, sound: f64) -> Value {
        if self.below(4) > 0 { json!(sound) } else { self.number(sound) }
    }

    fn choose<'a>(&mut self, words: &[&'a str]) -> &'a str {
        words[self.below(words.len())]
    }

    fn space(&mut self) -> Value {
        let mut inner = json!({"x_mm": self.number(0.3), "y_mm": self.number(-0.2)});
        let shape = self.choose(&["sphere", "cylinder", "bar", "edge"]);
        match shape {
            "sphere" => inner["radius_mm"] = self.number(10.0),
            "cylinder" => inner["radius_mm"] = self.number(23.0),
            "bar" => inner["width_mm"] = self.number(3.0),
            _ => {}
        }
        if shape != "sphere" {
            inner["rot_rad"] = self.number(0.4);
            if self.below(2) == 0 {
                inner["length_mm"] = self.number(6.0);
            }
        }
        if shape == "cylinder" || shape == "bar" {
            let tilt_rad = [0.0, 0.01][self.below(2)];
            inner["tilt_rad"] = self.number(tilt_rad);
        }
        let mut request = self.layer("contact_3d");
        request["shape"] = json!({ shape: inner });
        request["pitch_mm"] = self.number(1.6);
        request["level"] = json!("fast");
        (request["rows"], request["cols"]) = (json!(4), json!(4));
        if self.below(2) == 0 {
            request["force_n"] = self.number(2.0);
        } else {
            request["penetration_mm"] = self.number(0.01);
        }
        request
    }

    fn plane(&mut self) -> Value {
        let shape = match self.choose(&["knife", "flat", "cylinder", "profile"]) {
            "knife" => json!({"knife": {}}),
            "flat" => {
                json!({"flat": {"width_mm": self.number(4.0), "height_mm": self.number(2.0)}})
            }
            "cylinder" => json!({"cylinder": {"radius_mm": self.number(20.0)}}),
            _ => json!({"profile": {
                "x_mm": [self.number(-2.0), -1.0, 0.0, 1.0, self.number(2.0)],
                "z_mm": [self.number(0.2), 0.05, 0.0, 0.05, self.number(0.2)],
            }}),
        };
        let mut request = self.layer("contact_2d");
        request["shape"] = shape;
        request["friction"] = match self.below(4) {
            0 => json!("none"),
            1 => json!("prop"),
            2 => json!("stick"),
            _ => json!({"coulomb": self.number(0.5)}),
        };
        if self.below(3) > 0 {
            request["load"] = json!({"p_n_mm": self.number(0.5), "q_n_mm": self.number(0.05)});
        } else {
            request["move"] = json!({"dz_mm": self.number(0.01), "dx_mm": self.number(0.0)});
        }
        request["x_mm"] = json!([self.number(0.1), -1.0, 3.0]);
        if self.below(3) == 0 {
            request["depth_mm"] = self.number(0.4);
        }
        request
    }

    fn path(&mut self) -> Value {
        let at = json!({"x_mm": self.usually(0.05), "y_mm": self.usually(-0.1)});
        let shape = self.choose(&["sphere", "cylinder", "bar"]);
        let mut inner = at;
        match shape {
            "bar" => inner["width_mm"] = self.usually(1.0),
            _ => inner["radius_mm"] = self.usually(10.0),
        }
        if shape != "sphere" {
            inner["length_mm"] = self.usually(1.2);
            inner["rot_rad"] = self.usually(0.4);
            inner["tilt_rad"] = self.usually(0.002);
        }
        let layers: Vec<Value> = (0..=self.below(3))
            .map(|_| {
                json!({"t_mm": self.usually(0.4), "nu": self.usually(0.45),
                    "youngs_mpa": self.usually(27.58)})
            })
            .collect();
        let mut step = |drive: &str, sound: f64| {
            json!({drive: self.usually(sound), "dx_mm": self.usually(0.002),
                "dy_mm": self.usually(0.0), "turn_rad": self.usually(0.001)})
        };
        let steps = json!([step("force_n", 0.5), step("penetration_mm", 0.01)]);
        json!({"op": "contact_path_3d", "shape": {shape: inner}, "layers": layers, "steps": steps,
            "cells": {"columns": 16, "rows": 20, "spacing_mm": self.usually(0.12)},
            "friction": self.usually(0.4), "rows": 4, "cols": 4, "pitch_mm": self.usually(1.6)})
    }

    fn layer(&mut self, op: &str) -> Value {
        json!({"op": op, "t_mm": self.number(0.8), "nu": self.number(0.45),
            "youngs_mpa": self.number(27.58)})
    }
}

/// The complaint about an answer: a number that is not finite, or an error without a reason.
fn fault(request: &Value, answer: &Value, fields: &[&str]) -> Option<String> {
    if answer["ok"] == false {
        let error = &answer["error"];
        let coded = error["code"].as_str().is_some_and(|code| code != "internal");
        let told = error["message"].as_str().is_some_and(|message| message.len() > 10);
        return (!coded || !told).then(|| format!("{request}: {answer}"));
    }
    fn whole(values: &Value) -> bool {
        match values {
            Value::Array(items) => items.iter().all(whole),
            other => other.as_f64().is_some_and(f64::is_finite),
        }
    }
    let bad = fields.iter().find(|field| !whole(&answer[**field]))?;
    Some(format!("{bad} of {request}: {}", answer[*bad]))
}

/// The number of requests that were answered; every answer and every error has to be correct.
fn count_answered(requests: &[Value], fields: &[&str]) -> usize {
    let text: String = requests.iter().map(|request| format!("{request}\n")).collect();
    let answers = ask_text(text.as_bytes());
    assert_eq!(answers.len(), requests.len());
    let pairs = || requests.iter().zip(&answers);
    let faults: Vec<String> = pairs().filter_map(|(r, a)| fault(r, a, fields)).collect();
    assert!(faults.is_empty(), "{} at fault:\n{}", faults.len(), faults.join("\n"));
    pairs().filter(|(_, answer)| answer["ok"] == true).count()
}

#[test]
fn contact_in_space_answers_or_rejects_any_number() {
    let mut draws = RandomNumbers(1);
    let requests: Vec<Value> = (0..250).map(|_| draws.space()).collect();
    let answered = count_answered(&requests, &["image", "force_n", "residual"]);
    assert!((20..200).contains(&answered), "{answered}");
}

#[test]
fn contact_in_the_plane_answers_or_rejects_any_number() {
    let mut draws = RandomNumbers(2);
    let requests: Vec<Value> = (0..400).map(|_| draws.plane()).collect();
    let answered = count_answered(&requests, &["szz", "p_n_mm", "q_n_mm", "residual"]);
    assert!((20..300).contains(&answered), "{answered}");
}

#[test]
fn moving_bodies_answer_or_reject_any_number() {
    let mut draws = RandomNumbers(3);
    let requests: Vec<Value> = (0..150).map(|_| draws.path()).collect();
    let lists = ["image", "force_n", "along_n", "torque_n_mm", "delta_mm", "residual"];
    let answered = count_answered(&requests, &lists);
    assert!((5..120).contains(&answered), "{answered}");
}
