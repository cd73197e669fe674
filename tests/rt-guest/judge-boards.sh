# Judges what a guest with boards wrote: one line of key=value words for each part and each plan of faults, the last word the verdict.
# Sourced by `boards`. Refuses to call a guest that ended early or said something unreadable a success.
# shellcheck shell=bash
# `out` is set by guest.sh, `seconds`, `faults` and `direct` by `boards`.
# shellcheck disable=SC2154

# Faults as the bits of `supervisor.mode.faults`: encoders, D/A or lines do not answer; a count or a set point that jumped; touch silent.
readonly BOARD_LOST=$((1 << 2 | 1 << 3 | 1 << 4)) COUNTS_JUMPED=$((1 << 1 | 1 << 8 | 1 << 10)) TOUCH_MISSING=$((1 << 5 | 1 << 6))

# What is between two lines of an answer, the first one included.
between() { awk -v begin="$1" -v end="$2" '$0 ~ begin { on = 1 } on && end != "" && $0 ~ end && $0 !~ begin { exit } on'; }

# Faults that were latched at any time, as one word of bits.
latched() { awk '/^@faults/ { print $3 }' <<<"$1" | { local all=0 word; while read -r word; do all=$((all | word)); done; echo "$all"; }; }

# What the lanes and drivers counted: the number before a word in the line of a device or board.
counted() { # TEXT LINE WORD
    sed -n "s/^.*$2.*[^0-9]\([0-9][0-9]*\) $3.*$/\1/p" <<<"$1" | awk '{ sum += $1 } END { print sum + 0 }'
}

# Faults that the emulator put into a board's messages, by kind: `KIND NUMBER` after the board's name.
put_in() { # TEXT BOARD KIND
    sed -n "s/^$2: .*faults: .*$3 \([0-9][0-9]*\).*$/\1/p" <<<"$1" | awk '{ sum += $1 } END { print sum + 0 }'
}

# One run with its lanes: jobs, missed, skipped of all lanes in `jobs missed skipped`.
lanes_of() {
    read -r jobs missed skipped < <(sed -n 's/^lane [a-z]*: \([0-9]*\) jobs, \([0-9]*\) missed, \([0-9]*\) skipped.*/\1 \2 \3/p' <<<"$1" |
        awk '{ j += $1; m += $2; s += $3 } END { print j + 0, m + 0, s + 0 }')
}

# How the column of the contact differs from that of the simulator's own halves, driven in virtual time: in pieces of 8 s, each laid upon
# the direct run where it fits best, because the operator speaks at other instants. Prints the worst root mean square of a piece (tactels) and
# by how much the pieces moved against one another (s). Fails above 0.2 tactels, when the pace differs by more than 2 %, and without two
# seconds of contact.
compare_columns() { # TEXT DIRECT
    awk -v FS='[ ,]' '
        FNR == NR { if (FNR > 1) direct[++n] = $2; next }
        $1 == "@x_c" && $3 > 0 { if (!begin) begin = $2 + 1.5; if ($2 >= begin) { t[++m] = $2; x[m] = $3 } }
        # The mean square of a piece that is laid `lag` samples of 5 ms later than the direct run; none where that has no contact.
        function square(from, to, lag,    i, k, sum) {
            for (i = from; i <= to; i++) {
                k = int(t[i] * 200 + 0.5) - lag
                if (k < 1 || k > n || direct[k] <= 0) return -1
                sum += (x[i] - direct[k]) ^ 2
            }
            return sum / (to - from + 1)
        }
        END {
            low = 0; high = 2800
            for (from = 1; from <= m; from = to + 1) {
                for (to = from; to < m && t[to + 1] < t[from] + 8; to++);
                if (t[to] - t[from] < 2) break
                best = -1
                for (lag = low; lag <= high; lag++) {
                    found = square(from, to, lag)
                    if (found >= 0 && (best < 0 || found < best)) { best = found; at = lag }
                }
                if (best < 0) { failed = 1; break }
                if (best > worst) worst = best
                if (!pieces++) { first = at; low = at - 200; high = at + 200 }
                moved = at - first; span = t[from] - t[1]
            }
            printf "x_c_rms_to_direct=%.3f drift_s=%.3f", sqrt(worst), moved / 200
            exit !(pieces && !failed && sqrt(worst) <= 0.2 && moved / 200 <= 0.02 * span + 0.05 && -moved / 200 <= 0.02 * span + 0.05)
        }' "$2" <(cat <<<"$1")
}

# A part in which the pin is rolled without faults: columns LOW to HIGH at least, the load (counts) between LEAST and MOST.
judge_rolling() { # PART TEXT SECONDS LOW HIGH LEAST MOST [DIRECT]
    local part=$1 text=$2 verdict=pass bits seen beside=''
    grep -qx '@service 0' <<<"$text" || { verdict=fail; say "$part: the service did not end well"; }
    grep -qx '@emulator 0' <<<"$text" || { verdict=fail; say "$part: the emulator did not end well"; }
    lanes_of "$text"
    bits=$(latched "$text")
    if [[ -z $faults ]]; then
        ((jobs > 0 && missed == 0 && skipped == 0)) || { verdict=fail; say "$part: $missed of $jobs jobs missed, $skipped skipped"; }
        ((bits == 0)) || { verdict=fail; say "$part: faults $bits were latched"; }
        grep -q '^@tell state : ok TACTILE-SERVO' <<<"$text" || { verdict=fail; say "$part: the machine did not roll to the end"; }
        # The pin is under the finger: the column goes to and fro over most of the pad, and the load keeps near its set point.
        seen=$(awk -v seconds="$3" -v low_max="$4" -v high_min="$5" -v least="$6" -v most="$7" '
            /^@x_c / && $3 > 0 { if (!n || $3 < low) low = $3; if (!n || $3 > high) high = $3; n++ }
            /^@m0 / && $3 > least / 3 { sum += $3; loads++ }
            END {
                mean = loads ? sum / loads : 0
                printf "x_c=%.2f..%.2f m0_mean=%.0f", low, high, mean
                exit !(n > seconds && low < low_max && high > high_min && mean > least && mean < most)
            }' <<<"$text") || { verdict=fail; say "$part: the pin was not rolled"; }
        # Over a segment a frame that is later than its job waits for it is counted, and the reading is held.
        seen+=" timeouts=$(counted "$text" 'device arm' timeouts)"
        [[ $seen == *' timeouts=0' ]] || { verdict=fail; say "$part: frames came later than they are waited for"; }
        [[ -z ${8:-} ]] || beside=$(compare_columns "$text" "$8") || { verdict=fail; say "$part: the columns are not those of the direct run"; }
    else
        ((bits != 0)) || { verdict=fail; say "$part: no fault was latched"; }
        seen="latched=$bits"
    fi
    echo "rt-guest check=boards part=$part jobs=$jobs missed=$missed skipped=$skipped $seen${beside:+ $beside} verdict=$verdict"
    [[ $verdict == pass ]]
}

# The state that the operator was told at a mark.
state_at() { # TEXT MARK
    awk -v mark="$2" '$0 == mark { on = 1 } on && /^@tell state/ { print; exit }' <<<"$1"
}

plan_line() { # PLAN VERDICT WORDS...
    local plan=$1 verdict=$2
    shift 2
    echo "rt-guest check=boards part=faults plan=$plan $* verdict=$verdict"
    [[ $verdict == pass ]]
}

# The run through the shipped plans.
judge_faults() { # TEXT
    local text=$1 first second bits failed=0 verdict put seen again
    first=$(between '^@part' '^@again' <<<"$text")
    second=$(between '^@again' '^@nothing' <<<"$text")
    bits=$(latched "$first") again=$(latched "$second")
    lanes_of "$text"
    ((missed == 0 && skipped == 0 && jobs > 0)) || { failed=1; say "faults: $missed of $jobs jobs missed, $skipped skipped"; }
    [[ $(grep -cx '@service 0' <<<"$text") == 2 ]] || { failed=1; say "faults: a service did not end well"; }
    grep -qx '@emulator 0' <<<"$text" || { failed=1; say "faults: the emulator did not end well"; }

    rolls_at() { [[ $(state_at "$text" "$1") == *TACTILE-SERVO* ]]; }
    # A late answer comes after the one to the next request, or within a cycle that has none.
    seen=$(($(counted "$first" 'device card' 'late answers') + $(counted "$first" 'device card' 'overtaken answers')))
    put=$(put_in "$text" mesa delay) verdict=pass
    ((put >= 3 && seen >= put)) && rolls_at '@after spikes' || verdict=fail
    plan_line spikes "$verdict" "put_in=$put counted_late=$seen state=rolls" || failed=1

    put=$(put_in "$text" myrmex corruption) seen=$(counted "$first" 'device pad' 'times out of step') verdict=pass
    ((put > 5 && seen > put / 2)) && rolls_at '@after corruption' || verdict=fail
    plan_line corruption "$verdict" "put_in=$put counted_out_of_step=$seen state=rolls" || failed=1

    seen=$(counted "$first" 'device pad' 'times reopened') verdict=pass
    ((seen == 1 && bits & TOUCH_MISSING)) && rolls_at '@after pad-cable' || verdict=fail
    [[ $(state_at "$text" '@during pad-cable') != *TACTILE-SERVO* ]] || verdict=fail
    plan_line pad-cable "$verdict" "counted_reopened=$seen latched_touch=$((bits & TOUCH_MISSING)) state=rolls_again" || failed=1

    # Answers tell of writes that did not arrive; with the cable out there are no answers.
    put=$(put_in "$text" mesa loss) seen=$(counted "$first" 'device card' 'lost writes') verdict=pass
    ((put > 5 && seen >= 3 && $(counted "$first" 'device card' timeouts) > seen)) || verdict=fail
    # Rolling, or drives off because of two in a row: nothing else.
    rolls_at '@after loss' || [[ $(state_at "$text" '@after loss') == *'mode FAULT'* ]] || verdict=fail
    plan_line loss "$verdict" "put_in=$put counted_lost_writes=$seen" || failed=1

    put=$(put_in "$text" mesa unplugged) verdict=pass
    ((put > 10 && bits & BOARD_LOST)) || verdict=fail
    [[ $(state_at "$text" '@during card-cable') == *'mode FAULT'* ]] || verdict=fail
    [[ $(state_at "$text" '@after card-cable') == *'mode HOLD'* ]] || verdict=fail
    plan_line card-cable "$verdict" "put_in=$put latched=$((bits & BOARD_LOST)) drives=off service_again=holds" || failed=1

    put=$(put_in "$text" mesa corruption) verdict=pass
    ((put > 5)) || verdict=fail
    # It holds its position, or the drives are off for a board that cannot be believed.
    ((again == 0 || again & (BOARD_LOST | COUNTS_JUMPED))) || verdict=fail
    plan_line card-corruption "$verdict" "put_in=$put latched=$again" || failed=1

    # The board itself: no output stays on without its host for longer than its watchdog.
    seen=$(sed -n 's/^mesa: .*outputs on without a host for \([0-9.]*\) ms at most.*/\1/p' <<<"$text") verdict=pass
    awk -v seen="${seen:--1}" 'BEGIN { exit !(seen > 0 && seen <= 51) }' || verdict=fail
    ((!(bits & ~(BOARD_LOST | TOUCH_MISSING)))) || { verdict=fail; say "faults: others than declared were latched: $bits"; }
    plan_line all "$verdict" "jobs=$jobs missed=$missed outputs_on_without_host_ms=${seen:-unknown}" || failed=1
    ((!failed))
}

# The run through the plans of a segment, and the refusal of another product.
judge_segment_faults() { # TEXT
    local text=$1 bits failed=0 verdict put seen
    lanes_of "$text"
    ((missed == 0 && skipped == 0 && jobs > 0)) || { failed=1; say "ethercat_faults: $missed of $jobs jobs missed, $skipped skipped"; }
    grep -qx '@service 0' <<<"$text" || { failed=1; say "ethercat_faults: the service did not end well"; }
    grep -qx '@emulator 0' <<<"$text" || { failed=1; say "ethercat_faults: the emulator did not end well"; }
    segment_line() { # PLAN VERDICT WORDS...
        local plan=$1 verdict=$2
        shift 2
        echo "rt-guest check=boards part=ethercat_faults plan=$plan $* verdict=$verdict"
        [[ $verdict == pass ]]
    }
    put=$(put_in "$text" ethercat loss) seen=$(counted "$text" 'device arm' timeouts) verdict=pass
    ((put >= 5 && seen >= put)) && [[ $(state_at "$text" '@after loss') == *TACTILE-SERVO* ]] || verdict=fail
    segment_line loss "$verdict" "put_in=$put counted_timeouts=$seen state=rolls" || failed=1

    put=$(put_in "$text" ethercat silence) verdict=pass
    ((put >= 3 && put <= 4)) && [[ $(state_at "$text" '@after three') == *TACTILE-SERVO* ]] || verdict=fail
    segment_line three "$verdict" "put_in=$put state=rolls" || failed=1

    # Nothing is latched before the drive's fault: what was told of first is the write that failed.
    bits=$(awk '/^@faults/ { print $3; exit }' <<<"$text") verdict=pass
    bits=${bits:-0}
    ((bits == 1 << 3)) && [[ $(state_at "$text" '@during drive') == *'mode FAULT'* ]] || verdict=fail
    [[ $(state_at "$text" '@after drive') == *'mode HOLD'* && $(state_at "$text" '@moves again') == *'mode MOVING'* ]] || verdict=fail
    # The service says in the same second which drive it was, the fifth device, and its code, 8611.
    seen=$(grep -m1 '^latched: ' <<<"$text" | sed -n 's/.*[^0-9]\([0-9]*\) as code of the newest drive fault, \([0-9]*\) as device.*/\2:\1/p')
    [[ $seen == "5:$((0x8611))" ]] || verdict=fail
    segment_line drive "$verdict" "latched=$bits named_device_and_code=${seen:-none} after_reset_and_enable=moves" || failed=1

    put=$(put_in "$text" ethercat unplugged) seen=$(counted "$text" 'device arm' 'requests of operation') verdict=pass
    ((seen > 0 && put > 10)) && [[ $(state_at "$text" '@during cable') == *'mode FAULT'* ]] || verdict=fail
    [[ $(state_at "$text" '@after cable') == *'mode HOLD'* ]] || verdict=fail
    segment_line cable "$verdict" "put_in=$put requests_of_operation=$seen after_reset_and_enable=holds" || failed=1

    text=$(between '^@another product' '^@refused' <<<"$text") verdict=pass
    grep -qi 'position 2' <<<"$text" && grep -q '0x403' <<<"$text" && grep -q '0x402' <<<"$text" || verdict=fail
    segment_line product "$verdict" "refused=$(grep -qi 'position 2' <<<"$text" && echo by_name || echo no)" || failed=1
    ((!failed))
}

# Stops: every one of them answered, and taken within 50 ms of its line: the deceleration begins in the job that takes it.
judge_stops() { # TEXT
    local text=$1 verdict=pass name trials answered wanted longest all=0
    lanes_of "$text"
    ((jobs > 0 && missed == 0)) || { verdict=fail; say "stop: $missed of $jobs jobs missed"; }
    grep -qx '@service 0' <<<"$text" || { verdict=fail; say "stop: the service did not end well"; }
    grep -q '^@disk frozen' <<<"$text" || { verdict=fail; say "stop: no disk was frozen"; }
    (($(sed -n 's/^@log \([0-9]*\) bytes$/\1/p' <<<"$text") > 100000)) || { verdict=fail; say "stop: nothing was recorded before the disk froze"; }
    ! grep -q '^@trials failed\|^@stops failed' <<<"$text" || { verdict=fail; say "stop: a stop was not heard"; }
    for name in alone frozen crowded; do
        trials=$(between "@trials $name\$" '^@(trials [a-z]+|service .*|tell .*)$' <<<"$text" | grep '^@stops [ai][tn] ' || true)
        while read -r answered wanted longest; do
            all=$((all + answered))
            ((answered == wanted && answered > 0)) || { verdict=fail; say "stop: $name: $answered of $wanted answered"; }
            awk -v longest="$longest" 'BEGIN { exit !(longest >= 0 && longest <= 50) }' ||
                { verdict=fail; say "stop: $name: $longest ms until it was taken"; }
        done < <(sed -n 's/^@stops .* answered \([0-9]*\) of \([0-9]*\), .* longest \([-0-9.]*\) ms$/\1 \2 \3/p' <<<"$trials")
        echo "rt-guest check=boards part=stop case=$name $(sed -n 's/^@stops \(.*\) answered \([0-9]*\) of .*longest \(.*\) ms$/\1 \2 longest_ms=\3/p' <<<"$trials" | tr '\n' ';')"
    done
    ((all >= 100)) || { verdict=fail; say "stop: only $all stops were tried"; }
    echo "rt-guest check=boards part=stop jobs=$jobs missed=$missed stops=$all verdict=$verdict"
    [[ $verdict == pass ]]
}

# Judges one guest that played these parts.
judge_guest() { # NAME PART...
    local name=$1 result=$out/$1.result code host_s part failed=0 text
    shift
    read -r code host_s <"$out/$name.ended"
    if [[ $code != 0 ]] || ! grep -q '^@done ' "$result"; then
        failed=1
        say "$name: the guest ended with $code"
    fi
    [[ $(sed -n 's/^@kernel realtime=\([01]\).*/\1/p' "$result") == 1 ]] || { failed=1; say "$name: no PREEMPT_RT kernel"; }
    for part in "$@"; do
        text=$(between "^@part $part\$" '^@(part|done) ' <"$result")
        case $part in
            roll)
                judge_rolling roll "$text" "$seconds" 4.5 12.5 14000 16000 "$direct" || failed=1
                # The clock took each instant, within the second that it was read in.
                [[ $(awk '$1 == "@clock" && $3 - $2 >= 0 && $3 - $2 <= 1' <<<"$text" | wc -l) == 3 ]] ||
                    { failed=1; say "roll: the wall clock was not stepped"; }
                ;;
            flexitac) judge_rolling flexitac "$text" 3 13.5 20 800 1050 || failed=1 ;;
            regmap) judge_rolling regmap "$text" 3 6 11 14000 16000 "$direct" || failed=1 ;;
            faults) judge_faults "$text" || failed=1 ;;
            ethercat) judge_rolling ethercat "$text" "$seconds" 4.5 12.5 14000 16000 "$direct" || failed=1 ;;
            ethercat_faults) judge_segment_faults "$text" || failed=1 ;;
            stop) judge_stops "$text" || failed=1 ;;
        esac
    done
    local verdict=pass
    ((!failed)) || verdict=fail
    echo "rt-guest check=boards guest=$name parts=$(IFS=, && echo "$*") host_s=$host_s verdict=$verdict"
    ((!failed)) || { sed 's/^/    /' "$result"; tail -n 15 "$out/$name.qemu" "$out/$name.console"; } >&2
    ((!failed))
}
