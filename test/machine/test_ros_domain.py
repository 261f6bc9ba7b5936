"""Every process gets a ROS domain of its own, and gives it back."""
import subprocess
import sys

from neo_ros.machine.ros_domain import own_domain

ASK = 'from neo_ros.machine.ros_domain import own_domain; print(own_domain(), flush=True)'
# As if only so many were left: those that follow the given one.
FEW = ('import sys; from neo_ros.machine import ros_domain; '
       'first = int(sys.argv[1]); ros_domain.DOMAINS = range(first, first + 1)\n')


def ask(*arguments: object, code: str = ASK + '; input()', **environment: str) -> subprocess.Popen:
    """Start a process that says its domain and stays."""
    return subprocess.Popen([sys.executable, '-c', code, *map(str, arguments)], text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, env=environment or None)


def domain_of(process: subprocess.Popen) -> int:
    assert process.stdout is not None
    return int(process.stdout.readline())


def test_processes_hold_domains_of_their_own_until_they_end():
    processes = [ask() for _ in range(3)]
    domains = [domain_of(process) for process in processes]
    assert len({*domains, own_domain()}) == 4 and own_domain() == own_domain()
    assert own_domain(1) != own_domain() and own_domain(1) == own_domain(1)
    assert all(1 <= domain <= 100 for domain in domains)
    refused = ask(domains[0], code=FEW + ASK).communicate()[1]
    assert f'expected a free one of {domains[0]} to {domains[0]}' in refused
    processes[0].kill()
    processes[0].communicate()
    assert domain_of(again := ask(domains[0], code=FEW + ASK)) == domains[0]
    for process in (*processes[1:], again):
        process.communicate('\n')


def test_the_domain_of_the_environment_is_not_taken():
    first = domain_of(process := ask())
    process.communicate('\n')
    refused = ask(first, code=FEW + ASK, ROS_DOMAIN_ID=str(first)).communicate()[1]
    assert 'expected a free one' in refused
