#!/bin/sh
# First process of the user-mode Linux that hil/vcan/user_mode_linux.py starts: makes vcan0, runs the job, powers off.
# $job/settings, $job/command: what to run and how. tty1, tty2: its output and errors.
# tty3: signals for it, one name a line; closed when nobody waits for the job any more.
export PATH=/usr/sbin:/usr/bin:/sbin:/bin
exec 3>/dev/tty1 4>/dev/tty2 </dev/null

mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t tmpfs tmpfs /run
mkdir /dev/pts /dev/shm /run/lib
mount -t devpts devpts /dev/pts
mount -t tmpfs tmpfs /dev/shm
. "$job/settings"
echo "$host" >/proc/sys/kernel/hostname

ln -s /usr/lib/uml/modules /run/lib/modules
modprobe -a -d /run can-raw can-bcm vcan slcan
ip -batch - <<END
link set lo up
link add dev vcan0 type vcan
link set vcan0 up
END

stty raw -echo rows "$rows" columns "$columns" <&3
stty raw -echo rows "$rows" columns "$columns" <&4
{
    while read -r signal; do
        until [ -s /run/group ]; do sleep 0.1; done
        read -r group </run/group
        kill -s "$signal" -- "-$group"
    done </dev/tty3
    rm -r "$job"
    echo o >/proc/sysrq-trigger
} &
control=$!

run='echo $$ >/run/group; exec sh "$0/command" 3>&- 4>&-'
if [ "$is_terminal" = yes ]; then
    setsid -w sh -c "$run" "$job" >&3 2>&4
    status=$?
else # pipes, as outside, so that nobody takes them for a terminal
    mkfifo /run/output /run/errors
    cat /run/output >&3 &
    output=$!
    cat /run/errors >&4 &
    errors=$!
    setsid -w sh -c "$run" "$job" >/run/output 2>/run/errors
    status=$?
fi

# What the job left behind ends with it; its output does not.
for process in /proc/[1-9]*; do
    case ${process#/proc/} in
    1 | "$control" | "$output" | "$errors") ;;
    *) kill -s KILL "${process#/proc/}" ;;
    esac
done 2>/dev/null
[ "$is_terminal" = yes ] || wait "$output" "$errors"
stty -raw <&3 # returns when all output has left
stty -raw <&4
echo "$status" >"$job/status"
sync
echo o >/proc/sysrq-trigger
wait
