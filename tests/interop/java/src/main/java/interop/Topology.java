package interop;

import interop.original.TChannel;
import interop.original.TDirection;
import java.util.HashMap;
import java.util.HashSet;
import java.util.Map;
import java.util.Set;
import java.util.concurrent.atomic.AtomicInteger;

/** Reads a driver's channel `data` as the original's topologies do, and sends an answer to each message on `control`. */
final class Topology {
    private final Records records;
    private final Wire wire;
    private final AtomicInteger sent = new AtomicInteger();

    Topology(Records records, Wire wire) {
        this.records = records;
        this.wire = wire;
    }

    /** Answers with all headers that a message brought, whatever they are, as a program does that knows only some of them.
     *  The driver's message N has the time 1700000000000 + N and the property battery N; so has the answer, and reply N. */
    String answer(String driver, int count) throws Exception {
        Map<String, TChannel> data = records.channels(driver, "data");
        Map<String, TChannel> control = records.channels(driver, "control");
        if (data.isEmpty()) throw new IllegalStateException("no instance of the driver " + driver + " is deployed");
        var tally = new Tally(count * data.size());
        for (TChannel channel : control.values()) wire.open(channel);
        Set<String> topics = new HashSet<>();
        for (TChannel channel : data.values()) {
            if (channel.getDirection() != TDirection.OUT) throw new IllegalStateException("data is no channel to read");
            if (channel.isGrouped() && !topics.add(channel.getSite())) continue;  // one reader for all instances there
            wire.read(channel, message -> take(message, data, control, tally));
        }
        tally.await();
        return tally.answer(sent.get());
    }

    private void take(Message message, Map<String, TChannel> data, Map<String, TChannel> control, Tally tally) {
        String sensor = message.headers().get(Message.SENSOR);
        TChannel from = data.get(sensor);
        String number = message.text();
        boolean right = from != null && message.says(Map.of(Message.SITE, from.getSite(), Message.TIME,
                Long.toString(1_700_000_000_000L + Long.parseLong(number)), "battery", number))
                && !message.headers().containsKey("key");
        tally.count(message.othersThan("battery"));
        if (!tally.isFirst(sensor + " " + number, right) || from == null) return;
        Map<String, String> headers = new HashMap<>(message.headers());
        headers.put("reply", number);
        try {
            wire.write(control.get(sensor), new Message(message.body(), headers));
            sent.incrementAndGet();
            tally.done();
        } catch (Exception error) {
            throw new IllegalStateException(error);
        }
    }
}
