package iotcloud.bench.storm;

import com.rabbitmq.client.AMQP.BasicProperties;
import com.rabbitmq.client.Channel;
import com.rabbitmq.client.Connection;
import com.rabbitmq.client.ConnectionFactory;
import com.rabbitmq.client.DefaultConsumer;
import com.rabbitmq.client.Delivery;
import com.rabbitmq.client.Envelope;
import java.io.IOException;
import java.io.UncheckedIOException;
import java.util.Map;
import java.util.Queue;
import java.util.concurrent.ConcurrentLinkedQueue;
import org.apache.storm.spout.SpoutOutputCollector;
import org.apache.storm.task.TopologyContext;
import org.apache.storm.topology.OutputFieldsDeclarer;
import org.apache.storm.topology.base.BaseRichSpout;
import org.apache.storm.tuple.Fields;
import org.apache.storm.tuple.Values;

/**
 * Reads one driver's queue. The client's thread puts messages into a queue; nextTuple() takes one and never waits, as
 * Storm demands of spouts. Tracked, a message is acknowledged when its tuple tree is acked.
 */
final class RabbitSpout extends BaseRichSpout {
    private static final int PREFETCH = 100;  // our spout's default

    private transient Queue<Delivery> arrived;
    private transient Channel channel;
    private transient SpoutOutputCollector collector;
    private boolean tracked;

    @Override
    public void open(Map<String, Object> conf, TopologyContext context, SpoutOutputCollector collector) {
        this.collector = collector;
        arrived = new ConcurrentLinkedQueue<>();
        tracked = (Boolean) conf.get(Echo.TRACKED);
        String exchange = (String) conf.get(Echo.NAME);
        String queue = exchange + "." + context.getThisTaskIndex() + ".data";
        try {
            ConnectionFactory factory = new ConnectionFactory();
            factory.setUri((String) conf.get(Echo.URL));
            Connection connection = factory.newConnection("spout " + queue);
            channel = connection.createChannel();
            channel.basicQos(PREFETCH);
            channel.exchangeDeclare(exchange, "direct", false);
            channel.queueDeclare(queue, false, false, true, null);
            channel.queueBind(queue, exchange, queue);
            channel.basicConsume(queue, !tracked, "", false, true, null, new DefaultConsumer(channel) {
                @Override
                public void handleDelivery(String tag, Envelope envelope, BasicProperties properties, byte[] body) {
                    arrived.add(new Delivery(envelope, properties, body));
                }
            });
        } catch (Exception error) {
            throw new IllegalStateException("cannot read from " + queue, error);
        }
        Echo.taskConnected();
    }

    @Override
    public void nextTuple() {
        Delivery message = arrived.poll();
        if (message == null) {
            return;
        }
        Map<String, Object> headers = message.getProperties().getHeaders();
        Values values = new Values(headers.get("sensorID").toString(), message.getBody(), headers);
        if (tracked) {
            collector.emit(values, message.getEnvelope().getDeliveryTag());
        } else {
            collector.emit(values);
        }
    }

    @Override
    public void ack(Object id) {
        try {
            channel.basicAck((Long) id, false);
        } catch (IOException error) {
            throw new UncheckedIOException(error);
        }
    }

    @Override
    public void fail(Object id) {
        Counters.failed.incrementAndGet();
        try {
            channel.basicNack((Long) id, false, true);
        } catch (IOException error) {
            throw new UncheckedIOException(error);
        }
    }

    @Override
    public void declareOutputFields(OutputFieldsDeclarer declarer) {
        declarer.declare(new Fields("driver", "body", "headers"));
    }
}
