package interop;

import java.util.HashSet;
import java.util.Map;
import java.util.Set;
import java.util.TreeMap;
import java.util.concurrent.CountDownLatch;
import java.util.concurrent.TimeUnit;
import java.util.stream.Collectors;

/** Counts messages that are awaited once each, for at most LIMIT_S. Thread safe. */
final class Tally {
    static final int LIMIT_S = 120;
    private final Set<String> seen = new HashSet<>();
    private final CountDownLatch missing;
    private final Map<String, Integer> others = new TreeMap<>();
    private int twice = 0;
    private int wrong = 0;

    Tally(int awaited) {
        missing = new CountDownLatch(awaited);
    }

    /** Returns whether this is the first message of that name; done() follows when it is dealt with. */
    synchronized boolean isFirst(String name, boolean right) {
        if (!right) wrong++;
        if (seen.add(name)) return true;
        twice++;
        return false;
    }

    /** Counts the names of headers that nobody expects. */
    synchronized void count(Set<String> names) {
        for (String name : names) others.merge(name, 1, Integer::sum);
    }

    void done() {
        missing.countDown();
    }

    void await() throws InterruptedException {
        missing.await(LIMIT_S, TimeUnit.SECONDS);
    }

    synchronized String answer(int sent) {
        String named = others.entrySet().stream().map(entry -> entry.getKey() + "=" + entry.getValue())
                .collect(Collectors.joining(","));
        return "sent " + sent + " received " + seen.size() + " twice " + twice + " wrong " + wrong + " others "
                + (named.isEmpty() ? "none" : named);
    }
}
