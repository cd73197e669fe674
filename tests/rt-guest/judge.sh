# Judges what a guest wrote: one line of key=value words for each check and each lane, the last word the verdict. Sourced by `run`.
# Refuses to call a guest that ended early, counted too few jobs or answered something unreadable a success.
# shellcheck shell=bash
# `out` is set by `run`, `p99` and `max` of the reference by `judge_reference`.
# shellcheck disable=SC2154

# A reference later than this is no reference: measured 12 to 21 us with PREEMPT_RT, 48 us and more without.
readonly REFERENCE_LIMIT_US=40
# What the executor may add to cyclictest's worst release.
readonly MARGIN_US=5
# Longest job of an empty lane, 40000 instructions. These limits hold for the profiles release and dist.
readonly JOB_LIMIT_US=80
# That of the touch lane is what it declares, 50000 instructions: 10700 an image; in the job that closes the baseline 44800.
readonly TOUCH_JOB_LIMIT_US=100
# That of the servo lane, 58000 instructions: nine tasks are 28300, 9300 of them for comparing the motors' motion with their torques and
# with what is touched, 1350 more at `opt-level = 2` than at 3; a queue of moves adds 10400 to each job that looks at four ticks of it and
# 11100 to one that lays a move, the costliest of which is an inverse kinematics of 9600. The longest is 54800.
readonly SERVO_JOB_LIMIT_US=116
# What the executor itself takes in a cycle of an empty lane, job included: at p50 2000 instructions, evidence for misses included; measured 1527.
readonly EXECUTOR_LIMIT_US=4

# The part of a result between `@check NAME code` and `@stderr`.
answer() { # RESULT NAME
    awk -v name="$2" '$1 == "@check" { on = $2 == name; next } $1 == "@stderr" { on = 0 } on' "$1"
}

# samples p50 p99 p99.9 max (us) of one cyclictest check.
reference() { # RESULT CHECK
    answer "$1" "$2" | awk '
        /^[0-9]+ [0-9]+$/ { count[$1 + 0] += $2; n += $2 }
        /^# Max Latencies:/ { if ($4 + 0 > max) max = $4 + 0 }
        END {
            if (!n) exit 1
            for (us = 0; us <= max; us++) {
                sum += count[us]
                if (p50 == "" && sum >= 0.5 * n) p50 = us
                if (p99 == "" && sum >= 0.99 * n) p99 = us
                if (p999 == "" && sum >= 0.999 * n) p999 = us
            }
            print n, p50 + 0, p99 + 0, (p999 == "" ? max : p999), max
        }'
}

# Lanes of a `taktil` answer, one line each: name period_ns jobs skipped misses page_faults allocations, late p50 p99 p99.9 max,
# job p50 max, executor p50. What nobody counted is -1.
lanes() { # RESULT NAME
    answer "$1" "$2" | jq -r '.lanes[] | [(.name // "\(.rate_hz)Hz"), .period_ns, .jobs, .skipped, ([.misses[]] | add), .page_faults,
        (.allocations // -1), (.release_late_us | .p50, .p99, .p99_9, .max), ((.exec_us // .job_us) | .p50, .max),
        (.executor_us.p50 // -1)] | join(" ")'
}

at_most() { awk -v a="$1" -v b="$2" 'BEGIN { exit !(a <= b) }'; }

# Judges the lanes of one check beside the reference; returns 1 when any gate is open. Sets `late` when a gated lane was later than
# its limit.
judge_lanes() { # KERNEL CHECK SECONDS
    local name period jobs skipped misses faults allocations p50 p99 p999 max job_p50 job_max executor
    local seen=0 failed=0 verdict want job_limit limit=$((reference_max + MARGIN_US))
    while read -r name period jobs skipped misses faults allocations p50 p99 p999 max job_p50 job_max executor; do
        seen=1 verdict=pass
        want=$(($3 * 1000000000 / period))
        ((jobs == want && skipped == 0)) || verdict="jobs"
        ((misses == 0)) || verdict=misses
        ((faults == 0)) || verdict=page_faults
        ((allocations == 0)) || verdict=allocations
        # The lane that simulates the world is not part of what runs on a robot: its lateness is told, not judged.
        if [[ $name != world ]]; then
            job_limit=$JOB_LIMIT_US
            [[ $name != servo ]] || job_limit=$SERVO_JOB_LIMIT_US
            [[ $name != touch ]] || job_limit=$TOUCH_JOB_LIMIT_US
            at_most "$job_max" "$job_limit" || verdict=job_too_long
            at_most "$executor" "$EXECUTOR_LIMIT_US" || verdict=slow_executor
            at_most "$p99" $((reference_p99 + MARGIN_US)) || verdict=late_p99
            at_most "$max" "$limit" || { verdict=late; late=1; }
        fi
        [[ $verdict == pass ]] || failed=1
        echo "rt-guest kernel=$1 check=$2 lane=$name period_us=$((period / 1000)) jobs=$jobs late_p50_us=$p50" \
            "late_p99_us=$p99 late_p999_us=$p999 late_max_us=$max limit_us=$limit" \
            "job_p50_instructions=$(instructions "$job_p50") job_max_instructions=$(instructions "$job_max")" \
            "executor_p50_instructions=$(instructions "$executor")" \
            "misses=$misses skipped=$skipped page_faults=$faults allocations=$allocations verdict=$verdict"
    done < <(lanes "$out/$1.result" "$2")
    ((seen && !failed))
}

instructions() { awk -v us="$1" 'BEGIN { if (us < 0) print "-"; else printf "%d", us * 500 }'; }

# The worse of both references goes into `reference_p99` and `reference_max`; the control is held to those of PREEMPT_RT when both
# were run.
judge_reference() { # KERNEL
    local when n p50 p99 p999 max verdict failed=0 worst_p99=0 worst=0
    reference_late=0
    for when in before after; do
        read -r n p50 p99 p999 max < <(reference "$out/$1.result" "cyclictest-$when") ||
            { echo "rt-guest kernel=$1 check=cyclictest-$when verdict=broken"; return 1; }
        verdict=pass
        at_most "$max" "$REFERENCE_LIMIT_US" || failed=1 reference_late=1 verdict=late
        ((p99 <= worst_p99)) || worst_p99=$p99
        ((max <= worst)) || worst=$max
        echo "rt-guest kernel=$1 check=cyclictest-$when samples=$n late_p50_us=$p50 late_p99_us=$p99 late_p999_us=$p999" \
            "late_max_us=$max limit_us=$REFERENCE_LIMIT_US verdict=$verdict"
    done
    if [[ $1 != plain ]]; then
        reference_p99=$worst_p99 reference_max=$worst
    elif ((!reference_max)); then
        reference_p99=$REFERENCE_LIMIT_US reference_max=$REFERENCE_LIMIT_US
    fi
    ((!failed))
}

# What clients may add to the instructions of a lane's median job.
readonly CLIENTS_LIMIT_PERCENT=1

# The jobs beside sixteen clients against those of the same machine without; the clients have to have been answered.
judge_clients() { # KERNEL
    local name alone beside verdict seen=0 failed=0 said
    said=$(sed -n 's/^@clients //p' "$out/$1.result" | head -n 1)
    while read -r name alone beside; do
        seen=1 verdict=pass
        awk -v a="$alone" -v b="$beside" -v most=$CLIENTS_LIMIT_PERCENT 'BEGIN { exit !(a > 0 && b > 0 && (b - a) ^ 2 <= (most * a / 100) ^ 2) }' ||
            { verdict=costs_instructions failed=1; }
        echo "rt-guest kernel=$1 check=clients lane=$name job_p50_instructions=$(instructions "$beside")" \
            "without=$(instructions "$alone") limit_percent=$CLIENTS_LIMIT_PERCENT verdict=$verdict"
    done < <(join <(lanes "$out/$1.result" machine | awk '$1 != "world" { print $1, $12 }' | sort) \
        <(lanes "$out/$1.result" clients | awk '$1 != "world" { print $1, $12 }' | sort))
    verdict=pass
    [[ $seen == 1 && $said == *" failed 0" ]] || verdict=not_answered failed=1
    echo "rt-guest kernel=$1 check=clients ${said:+clients=${said// /_} }verdict=$verdict"
    ((!failed))
}

# Judges one guest. For PREEMPT_RT every gate has to hold; the control has to be late, and only that is asked of it.
judge() { # KERNEL SECONDS
    local result=$out/$1.result failed=0 code host_s check realtime
    read -r code host_s <"$out/$1.ended"
    if [[ $code != 0 ]] || ! grep -q '^@done ' "$result"; then
        # 124: the guest did not end in its time.
        echo "rt-guest kernel=$1 check=guest qemu_exit=$code host_s=$host_s verdict=broken"
        tail -n 15 "$out/$1.qemu" "$out/$1.console" >&2
        return 1
    fi
    realtime=$(sed -n 's/^@kernel realtime=\([01]\).*/\1/p' "$result")
    late=0
    judge_reference "$1" || failed=1
    ((reference_max)) || return 1
    while read -r check; do
        judge_lanes "$1" "$check" "$2" || failed=1
        grep -q "^@check $check 0\$" "$result" ||
            { failed=1; echo "rt-guest kernel=$1 check=$check verdict=failed"; complaint "$result" "$check"; }
    done < <(awk '$1 == "@check" && $2 !~ /^cyclictest/ { print $2 }' "$result")
    # shellcheck disable=SC2154  # `run` sets `clients`.
    [[ $1 == plain || $clients == none ]] || judge_clients "$1" || failed=1
    local verdict=pass
    if [[ $1 == plain ]]; then
        # The control: cyclictest and our lanes must both be seen to be late, or the gate could not fail.
        verdict=fails_as_it_must failed=1
        [[ $realtime != 0 || $late == 0 || $reference_late == 0 ]] || failed=0
    else
        [[ $realtime == 1 ]] || failed=1
    fi
    ((!failed)) || verdict=fail
    echo "rt-guest kernel=$1 check=all realtime=$realtime seconds=$2 host_s=$host_s verdict=$verdict"
    ((!failed))
}

# What a check that ended with an error said.
complaint() { # RESULT NAME
    awk -v name="$2" '$1 == "@check" { mine = $2 == name } $1 == "@end" { on = 0 } on && mine; $1 == "@stderr" { on = 1 }' "$1" >&2
}
